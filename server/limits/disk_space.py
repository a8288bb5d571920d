"""How much space is left where the server writes."""

import shutil
from pathlib import Path


def disk_standing(folder: Path, min_free_bytes: int) -> str:
    """How much space a folder has: `ok`, or what is missing."""
    try:
        free_bytes = shutil.disk_usage(folder).free
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    if free_bytes < min_free_bytes:
        return f"full: {free_bytes // 1_000_000} MB free, {min_free_bytes // 1_000_000} MB needed"
    return "ok"
