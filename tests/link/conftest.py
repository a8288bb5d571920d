"""Yards shared by the tests of one file: starting a machine's processes takes seconds."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "runtime"))

from quick_policy import write_policies
from yard import Yard


@pytest.fixture(scope="session")
def policies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_policies(tmp_path_factory.mktemp("policies"))


@pytest.fixture(scope="module")
def shared_yard(tmp_path_factory: pytest.TempPathFactory, policies: Path) -> Iterator[Yard]:
    yard = Yard(tmp_path_factory.mktemp("yard"), policies)
    yield yard
    yard.close()


@pytest.fixture
def yard(shared_yard: Yard) -> Yard:
    """A yard with a connected, disarmed machine."""
    shared_yard.ready()
    return shared_yard
