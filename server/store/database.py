"""Access to the database: SQLite in WAL mode, or PostgreSQL. Transactions are explicit and short.

`read()` and `write()` open a session for one transaction. On SQLite a write begins with BEGIN IMMEDIATE
and waits its turn at a lock of this process, so that "database is locked" cannot happen among ourselves.
"""

import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, create_engine, event, inspect, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session, sessionmaker
from sqlalchemy.pool import ConnectionPoolEntry

from machine.errors import DownrangeError
from server.secret_files import make_private
from server.settings import CHECKOUT

BUSY_TIMEOUT_MS = 5000
RowT = TypeVar("RowT")
MIGRATIONS = CHECKOUT / "migrations"


class DatabaseError(DownrangeError):
    """A database that cannot be used as it is."""

    code = "database"


class DatabaseStanding(StrEnum):
    """How the database relates to this software."""

    EMPTY = "empty"
    OLDER = "older"
    CURRENT = "current"
    NEWER = "newer"


class Database:
    """One database for the life of the process."""

    def __init__(self, url: str) -> None:
        parsed = make_url(url)
        self.dialect = parsed.get_backend_name()
        if self.dialect not in ("sqlite", "postgresql"):
            raise DatabaseError(
                f"database '{self.dialect}' is not supported; use sqlite or postgresql"
            )
        self.url = url
        self.shown_url = parsed.render_as_string(hide_password=True)
        if parsed.database and self.dialect == "sqlite":
            make_private(Path(parsed.database))
        options: dict[str, Any] = {"pool_size": 16, "max_overflow": 48}
        if self.dialect == "postgresql":
            options["pool_pre_ping"] = True
        self.engine = create_engine(url, **options)
        if self.dialect == "sqlite":
            event.listen(self.engine, "connect", _set_up_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
        writer = self.engine.execution_options(is_write=True)
        self._read = sessionmaker(self.engine, expire_on_commit=False)
        self._write = sessionmaker(writer, expire_on_commit=False)
        self._turn = threading.Lock()

    @contextmanager
    def read(self) -> Generator[Session]:
        """One transaction that only reads."""
        with self._read() as session:
            yield session

    @contextmanager
    def write(self) -> Generator[Session]:
        """One transaction that is committed at the end, or rolled back on any error."""
        if self.dialect == "sqlite":
            with self._turn, self._write.begin() as session:
                yield session
        else:
            with self._write.begin() as session:
                yield session

    def on_insert(self, kind: type[RowT], listener: Callable[[Session, RowT], None]) -> None:
        """Call a listener for each new row of a table, inside the write transaction that adds it."""

        def look(session: Session, _context: object, _instances: object) -> None:
            for row in list(session.new):
                if isinstance(row, kind):
                    listener(session, row)

        event.listen(self._write, "before_flush", look)

    def close(self) -> None:
        """Close all connections; one that a thread still uses is closed when it comes back."""
        event.listen(self.engine, "checkin", _close_returned)
        self.engine.dispose()

    def ping(self) -> None:
        """Do the least that proves the database answers."""
        with self.engine.connect() as connection:
            connection.execute(text("SELECT 1"))

    def revision(self) -> str | None:
        """The schema's revision, None when it has none."""
        with self._connect() as connection:
            return MigrationContext.configure(connection).get_current_revision()

    def standing(self) -> DatabaseStanding:
        """How the schema relates to this software."""
        scripts = ScriptDirectory.from_config(alembic_config(self.url))
        found = self.revision()
        if found is None:
            with self._connect() as connection:
                tables = set(inspect(connection).get_table_names()) - {"alembic_version"}
            if tables:
                raise DatabaseError(
                    f"{self.shown_url} holds {len(tables)} tables but no schema revision: it is not "
                    "a Downrange database; point DOWNRANGE_DATABASE_URL to another one"
                )
            return DatabaseStanding.EMPTY
        if found == scripts.get_current_head():
            return DatabaseStanding.CURRENT
        known = {script.revision for script in scripts.walk_revisions()}
        return DatabaseStanding.OLDER if found in known else DatabaseStanding.NEWER

    def require_current(self) -> None:
        """Refuse a schema that is not this software's.

        Raises:
            DatabaseError: older, newer or not there, with the remedy.
        """
        standing = self.standing()
        if standing is DatabaseStanding.CURRENT:
            return
        head = ScriptDirectory.from_config(alembic_config(self.url)).get_current_head()
        found = self.revision()
        if standing is DatabaseStanding.NEWER:
            raise DatabaseError(
                f"{self.shown_url} has schema {found}, newer than this software's {head}: "
                "install the newer software, or restore the backup made before the upgrade"
            )
        raise DatabaseError(
            f"{self.shown_url} has schema {found or 'none'}, older than this software's {head}: "
            "make a backup and run `downrange db upgrade`"
        )

    @contextmanager
    def _connect(self) -> Generator[Connection]:
        try:
            with self.engine.connect() as connection:
                yield connection
        except OperationalError as error:
            raise DatabaseError(
                f"{self.shown_url} cannot be reached: {str(error.orig).strip()}; "
                "check DOWNRANGE_DATABASE_URL and that the database runs"
            ) from error


def alembic_config(url: str) -> Config:
    """Alembic's configuration; works wherever the checkout lies."""
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.set_main_option("path_separator", "os")
    config.attributes["url"] = url
    return config


def upgrade(url: str, revision: str = "head") -> None:
    """Bring the schema to a revision, the newest one by default."""
    command.upgrade(alembic_config(url), revision)


def _close_returned(_connection: object, record: ConnectionPoolEntry) -> None:
    record.invalidate()


def _set_up_sqlite(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # transactions begin where `_begin_sqlite` says, nowhere else
    cursor = connection.cursor()
    for pragma in (
        "journal_mode=WAL",
        # An acknowledged event is deleted on the machine: it must survive a power cut here.
        "synchronous=FULL",
        f"busy_timeout={BUSY_TIMEOUT_MS}",
        "foreign_keys=ON",
        "cache_size=-65536",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    is_write = connection.get_execution_options().get("is_write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if is_write else "BEGIN")
