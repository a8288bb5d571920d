"""Files that only their owner can read."""

from pathlib import Path


def write_secret(path: Path, text: str) -> None:
    """Write a file that only its owner can read."""
    make_private(path)
    path.write_text(text, encoding="utf-8")


def make_private(path: Path) -> None:
    """Create a file, or take an existing one, so that only its owner can read it.

    SQLite gives the files beside its database (write-ahead log, shared memory) the same mode.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch(mode=0o600)
    path.chmod(0o600)
