"""The seal of an audit row: a hash over the row and the seal before it."""

import hashlib
import json
from collections.abc import Sequence

FIRST_SHA256 = "0" * 64
"""Stands for the seal before the first row."""
SEALED_FIELDS = (
    "sequence_count",
    "t_utc",
    "actor",
    "session_id",
    "machine_id",
    "throw_id",
    "action",
    "phase",
    "detail_json",
)
"""What a seal covers, in its order; `t_utc` is ISO 8601 with microseconds, `detail_json` a text."""


def seal_of(previous_sha256: str, values: Sequence[str | int | None]) -> str:
    """sha256 of the previous seal and the row's canonical JSON, hex.

    Args:
        previous_sha256: seal of the row before.
        values: of `SEALED_FIELDS`.
    """
    content = json.dumps(list(values), separators=(",", ":"))
    return hashlib.sha256(f"{previous_sha256}\n{content}".encode()).hexdigest()
