"""The files that the tests of structure and documents walk through."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def packages() -> tuple[str, ...]:
    """Top-level Python packages: those that the wheel holds."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return tuple(settings["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"])


def python_files() -> list[Path]:
    """All source files of the packages, without tests and scripts."""
    return [path for package in packages() for path in sorted((ROOT / package).rglob("*.py"))]


def documents() -> list[Path]:
    """All documents that ship."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def shown(path: Path) -> str:
    """A path as a failure names it."""
    return str(path.relative_to(ROOT))
