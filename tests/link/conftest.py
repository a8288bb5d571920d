"""Yards shared by the tests of one file: starting a machine's processes takes seconds."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.link.yard import Yard
from tests.runtime.quick_policy import write_policies


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
