"""A running server on a free port, and people to use it."""

import contextlib
import functools
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from machine.conventions import Mode
from machine.policy_card import load_card
from server.app import create_app
from server.clock import utc_now
from server.composition import Parts
from server.plans.preview_pool import PreviewPool
from server.schemas.console import Role
from server.serve import make_server, open_socket
from server.settings import Settings
from server.store.models import LoginSession
from tests.ports import free_port
from tests.server.fake_machine import FakeMachine
from tests.waiting import wait_for as wait_for

PASSWORD = "correct horse battery"
METRICS_TOKEN = "read-the-metrics"


@functools.cache
def api_paths() -> dict[str, Any]:
    """Operations of the interface by path and method, as its description has them."""
    return create_app(Settings(data_dir=Path("/nonexistent"))).openapi()["paths"]


@dataclass
class Running:
    """A server that answers."""

    url: str
    settings: Settings
    parts: Parts

    @contextlib.contextmanager
    def client(self, username: str = "", password: str = PASSWORD) -> Iterator[httpx.Client]:
        """A browser-like client, signed in if a name is given."""
        with httpx.Client(
            base_url=f"{self.url}/api/v1",
            headers={"Origin": self.url, "X-Requested-With": "downrange"},
            timeout=60.0,
        ) as client:
            if username:
                body = {"username": username, "password": password}
                reply = client.post("/auth/login", json=body)
                assert reply.status_code == 200, reply.text
            yield client

    def machine(self, machine_id: str = "m001") -> FakeMachine:
        return FakeMachine(
            self.settings.link_listen,
            machine_id,
            self.parts.registry.secret_path(machine_id).read_text().strip(),
            {
                mode.value: load_card(
                    self.settings.policies_dir / f"swing-{mode.value}"
                ).policy_sha256
                for mode in Mode
            },
        )


@contextlib.contextmanager
def running_server(settings: Settings) -> Iterator[Running]:
    """Run a server in a thread until the block ends; preview processes start with the first preview."""
    ready = threading.Event()
    with (
        pytest.MonkeyPatch.context() as patch,
        open_socket(settings.host, settings.port_count) as listener,
    ):
        patch.setattr(PreviewPool, "start", _start_later)
        server, app = make_server(settings, ready.set)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            while not ready.wait(0.05):
                assert thread.is_alive(), getattr(app.state, "startup_error", "server died")
            url = f"http://{settings.host}:{settings.port_count}"
            yield Running(url, settings, app.state.parts)
        finally:
            server.should_exit = True
            thread.join(timeout=60.0)
            assert not thread.is_alive(), "the server did not stop"


def _start_later(pool: PreviewPool) -> None:
    pool._pool = pool._new_pool()
    pool._thread.start()


def make_settings(data_dir: Path, policies: Path, **overrides: object) -> Settings:
    values: dict[str, object] = {
        "data_dir": data_dir,
        "policies_dir": policies,
        "web_dir": data_dir / "no-web",
        "port_count": free_port(),
        "link_listen": f"tcp/127.0.0.1:{free_port()}",
        "machine_slot_count": 2,
        "preview_worker_count": 1,
        "lease_ttl_s": 300.0,
        "metrics_token": METRICS_TOKEN,
    }
    return Settings.model_validate(values | overrides)


def clear_stop(
    client: httpx.Client, latch_id: str | None = None, reason: str = "nobody is in reach"
) -> httpx.Response:
    """Clear a stop as a person does who sees the machine; the latch is the one that is shown now."""
    shown = client.get("/machines/m001").json()["state"]["latch_id"]
    body = {"latch_id": latch_id or shown or "none", "is_sighted": True, "reason": reason}
    return client.post("/machines/m001/stop/clear", json=body)


def run_out(parts: Parts, client: httpx.Client) -> None:
    """Let the session of a client reach its end, without a logout."""
    session_id = client.get("/auth/me").json()["session_id"]
    with parts.database.write() as database:
        row = database.get(LoginSession, session_id)
        assert row is not None
        row.expires_utc = utc_now() - timedelta(seconds=1.0)


def add_people(parts: Parts) -> None:
    for name, role in (
        ("ada", Role.OPERATOR),
        ("bob", Role.OPERATOR),
        ("sue", Role.SUPERVISOR),
        ("vic", Role.VIEWER),
        ("eve", Role.ENGINEER),
        ("root", Role.ADMIN),
    ):
        parts.accounts.create_user(name, PASSWORD, role)
