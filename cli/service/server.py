"""`downrange server`: run the web service."""

import logging
from pathlib import Path

from server.serve import serve
from server.settings import load_settings


def run(
    *,
    host: str | None = None,
    port: int | None = None,
    data: Path | None = None,
    policies: Path | None = None,
) -> int:
    """Run console, HTTP interface, 3D view and the machines' router on this computer.

    Everything can be set by environment variables (DOWNRANGE_...); arguments take precedence.

    Args:
        host: address to listen on, 127.0.0.1 by default.
        port: port to listen on, 8000 by default.
        data: folder of database, throw logs and secrets.
        policies: folder of policy versions.
    """
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    settings = load_settings(host=host, port_count=port, data_dir=data, policies_dir=policies)
    for line in settings.lines():
        print(line)
    address = f"http://{settings.host}:{settings.port_count}"
    serve(settings, lambda: print(f"Downrange answers at {address}", flush=True))
    return 0
