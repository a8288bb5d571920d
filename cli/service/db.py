"""`downrange db`: bring the database's schema up, down, or look at it."""

from typing import Annotated, Literal

import tyro
from alembic import command
from alembic.util import CommandError

from server.settings import load_settings
from server.store.database import Database, DatabaseError, DatabaseStanding, alembic_config


def run(
    action: Annotated[Literal["upgrade", "downgrade", "current", "check"], tyro.conf.Positional],
    revision: Annotated[str | None, tyro.conf.Positional] = None,
    /,
) -> int:
    """Manage the schema of the database named by DOWNRANGE_DATABASE_URL, or of the one in the data folder.

    Args:
        action: upgrade (to the newest or a given revision), downgrade (one step or to a given
            revision, `base` for none), current (show the revision), check (exit 1 unless it is this
            software's).
        revision: a revision's name.
    """
    settings = load_settings()
    database = Database(settings.resolved_database_url)
    try:
        return _act(database, action, revision)
    except CommandError as error:
        raise DatabaseError(
            f"{error}; `downrange db current` shows the present revision"
        ) from error
    finally:
        database.close()


def _act(database: Database, action: str, revision: str | None) -> int:
    config = alembic_config(database.url)
    standing = database.standing()
    if action == "upgrade":
        if standing is DatabaseStanding.NEWER:
            database.require_current()
        command.upgrade(config, revision or "head")
        print(f"{database.shown_url}: now at {database.revision() or 'base'}")
    elif action == "downgrade":
        command.downgrade(config, revision or "-1")
        print(f"{database.shown_url}: now at {database.revision() or 'base'}")
    elif action == "current":
        print(f"{database.shown_url}: {database.revision() or 'no schema'} ({standing.value})")
    else:
        database.require_current()
        command.check(config)
        print(f"{database.shown_url}: schema and software agree")
    return 0
