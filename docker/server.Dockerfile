# Server and console. Build from the repository's root: docker build -f docker/server.Dockerfile -t downrange-server .
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends make git && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/downrange
COPY . .
RUN make web && useradd --create-home downrange && mkdir /data && chown downrange /data
USER downrange
VOLUME /data
EXPOSE 8000 7447
# Everything else by DOWNRANGE_* variables (docs/operations.md).
ENTRYPOINT [".venv/bin/downrange", "server", "--host", "0.0.0.0", "--data", "/data"]
