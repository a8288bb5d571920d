"""Render a report's template to one HTML page: no script, no network, light and dark.

Everything that comes from data (file names, notes, channel names) is escaped by the template engine. The
page's own content security policy forbids scripts and requests as a second barrier.
"""

from functools import cache
from pathlib import Path
from typing import Any, cast

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports.number_format import NONE, crossrange, downrange, fixed, metres, percent, probability

TEMPLATES = Path(__file__).parent / "templates"


@cache
def _environment(folder: Path) -> Environment:
    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        fixed=fixed,
        metres=metres,
        percent=percent,
        probability=probability,
        downrange=downrange,
        crossrange=crossrange,
    )
    # The style sheet is a file of this package, not data.
    style = Markup((TEMPLATES / "report.css").read_text(encoding="utf-8"))
    cast("dict[str, Any]", environment.globals).update(NONE=NONE, style=style)
    return environment


def render_page(folder: Path, name: str, **context: Any) -> str:
    """Render the template `name` of a folder; it extends ``base.html.j2`` of this package."""
    return _environment(folder).get_template(name).render(**context) + "\n"
