"""What the trainer's tests share: every environment compiles once."""

from collections.abc import Iterator

import jax
import pytest

from machine.conventions import Mode
from tests.training.tiny_training import Throws, throws_of


@pytest.fixture(scope="session", autouse=True)
def _quick_compiler() -> Iterator[None]:
    """On the CPU, in half the time to compile; the arithmetic is the same."""
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(scope="session", params=list(Mode), ids=lambda mode: mode.value)
def throws(request: pytest.FixtureRequest) -> Throws:
    """Our configuration, in both modes."""
    return throws_of(request.param, "impact")


@pytest.fixture(scope="session")
def planar() -> Throws:
    """Our configuration in 2D."""
    return throws_of(Mode.PLANAR, "impact")


@pytest.fixture(scope="session")
def spatial() -> Throws:
    """Our configuration in 3D."""
    return throws_of(Mode.SPATIAL, "impact")


@pytest.fixture(scope="session")
def paper() -> Throws:
    """The paper's configuration in 2D."""
    return throws_of(Mode.PLANAR, "paper")
