"""`downrange openapi`: write the description of the HTTP interface, from which clients are generated."""

import json
from pathlib import Path

from server.app import create_app


def run(*, out: Path) -> int:
    """Write the OpenAPI document.

    Args:
        out: the file to write, as in web/openapi.json.
    """
    text = json.dumps(create_app().openapi(), indent=1, sort_keys=True) + "\n"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
    print(f"wrote {out}")
    return 0
