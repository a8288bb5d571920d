"""`downrange openapi`: write the description of the HTTP interface, from which clients are generated."""

import json
from pathlib import Path

from server.app import create_app, openapi_document
from server.settings import Settings


def run(*, out: Path) -> int:
    """Write the OpenAPI document.

    Args:
        out: the file to write, as in web/openapi.json.
    """
    document = openapi_document(create_app(Settings()))
    text = json.dumps(document, indent=1, sort_keys=True) + "\n"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
    print(f"wrote {out}")
    return 0
