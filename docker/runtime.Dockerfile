# What runs on a machine's computer: runtime only, none of the server's packages.
# docker build -f docker/runtime.Dockerfile -t downrange-runtime .
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends make && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/downrange
COPY . .
RUN make runtime && mkdir /data
VOLUME /data
# The control loop asks for SCHED_FIFO and locked memory: run with --cap-add SYS_NICE --ulimit memlock=-1.
ENTRYPOINT [".venv/bin/downrange", "machine", "--data", "/data"]
