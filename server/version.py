"""Version of this software, from the installed package."""

from importlib.metadata import PackageNotFoundError, version


def _read() -> str:
    try:
        return version("downrange")
    except PackageNotFoundError:
        return "0+checkout"  # run from a checkout that was never installed


SOFTWARE = _read()
