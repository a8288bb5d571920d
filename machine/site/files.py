"""Sites as files: a JSON list of objects."""

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from machine.errors import UsageError
from machine.site.objects import SiteObject, SiteObjects

SITE: TypeAdapter[tuple[SiteObject, ...]] = TypeAdapter(SiteObjects)


def load_site(path: Path) -> tuple[SiteObject, ...]:
    """Read a site: a JSON list of objects.

    Raises:
        UsageError: no such file, or not a site, with what is wrong.
    """
    try:
        return SITE.validate_json(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise UsageError(f"{path} is not a site: {where} {first['msg']}") from error
