"""Bodies of the HTTP interface for what stands around a machine."""

from datetime import datetime

from pydantic import Field

from machine.site.objects import SiteObjects
from server.schemas.console import Request, View


class SiteRequest(Request):
    """All objects of a site as they are from now on."""

    objects: SiteObjects
    from_version_count: int = Field(ge=0)
    """Version that was changed; refused if somebody else was quicker."""


class SiteView(View):
    """What stands around a machine, frame `machine`."""

    machine_id: str
    version_count: int
    """0 while nobody has described the site."""
    objects: SiteObjects
    undo_version_count: int | None
    """Version that undo goes back to; null when there is none."""
    changed_by: str | None
    changed_utc: datetime | None
