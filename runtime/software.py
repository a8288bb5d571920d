"""Which software runs here, for logs and state messages."""

from importlib import metadata


def software_version() -> str:
    """Name and version of the installed distribution; a source tree that is not installed has none."""
    try:
        return f"downrange {metadata.version('downrange')}"
    except metadata.PackageNotFoundError:
        return "downrange (source tree)"
