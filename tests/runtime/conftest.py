"""Fixtures of the runtime's tests."""

from pathlib import Path

import pytest

from tests.runtime.machine_bench import Bench
from tests.runtime.quick_policy import write_policies


@pytest.fixture(scope="session")
def quick_policies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Policies that throw within a second."""
    return write_policies(tmp_path_factory.mktemp("quick"))


@pytest.fixture
def bench(quick_policies: Path) -> Bench:
    """A machine under control, stepped by the test."""
    return Bench(quick_policies)
