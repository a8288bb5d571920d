"""Router, stand-in server, relay and machine, fresh for each test."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "runtime"))

from quick_policy import write_policies
from relay import Relay
from yard import Machine, Server, free_port, make_plan

from machine.messages import ThrowPlan


@pytest.fixture(scope="session")
def policies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_policies(tmp_path_factory.mktemp("policies"))


@pytest.fixture
def plan(policies: Path) -> ThrowPlan:
    return make_plan(policies)


@pytest.fixture
def router_port() -> int:
    return free_port()


@pytest.fixture
def server(tmp_path: Path, router_port: int) -> Iterator[Server]:
    server = Server(tmp_path, router_port)
    yield server
    server.go_silent()
    server.close()


@pytest.fixture
def relay(router_port: int) -> Iterator[Relay]:
    relay = Relay(router_port)
    yield relay
    relay.close()


@pytest.fixture
def machine(tmp_path: Path, policies: Path, relay: Relay) -> Iterator[Machine]:
    machine = Machine(tmp_path / "m001", policies, relay.endpoint)
    yield machine
    machine.end()
