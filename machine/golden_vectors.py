"""Golden vectors: observations and the actions that a policy's training computed for them.

They lie beside the network as ``golden_vectors.json``. A network whose inputs or outputs were permuted,
scaled or normalised otherwise on the way gives other actions, and is refused before it moves anything.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from machine.conventions import Array
from machine.errors import PolicyError
from machine.policy_card import GOLDEN_FILE, content_problems

VECTOR_COUNT: Final = 16
TOLERANCE: Final = 1e-4
"""Of an action, relative where it is beyond 1: ten times what float32 sums differ by between processors."""
SPREAD_RATIO: Final = 1.5
"""Standard deviations of the training's observations over which golden ones are drawn: inputs near their
mean would hide a wrong scale, far ones would be clipped."""


class GoldenVectors(BaseModel):
    """Observations and expected actions, float32."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    schema_version: Literal[1] = 1
    observations: tuple[tuple[float, ...], ...] = Field(min_length=8, max_length=32)
    """(n, observations), before the normaliser, in the order of the card's names."""
    actions: tuple[tuple[float, ...], ...] = Field(min_length=8, max_length=32)
    """(n, actions), as the network gives them (not clipped)."""
    tolerance: float = Field(default=TOLERANCE, gt=0.0, le=1e-3)
    """Largest difference of an action, relative where the expected one is beyond 1."""

    @model_validator(mode="after")
    def _are_rectangular(self) -> "GoldenVectors":
        widths = {len(row) for row in self.observations}, {len(row) for row in self.actions}
        if len(self.observations) != len(self.actions) or any(len(w) != 1 for w in widths):
            raise ValueError("observations and actions must be as many, each of one width")
        values = np.concatenate([np.ravel(self.observations), np.ravel(self.actions)])
        if not np.isfinite(values).all():
            raise ValueError("observations and actions must be finite")
        return self

    def check(self, infer: Callable[[Array], Array], names: tuple[str, ...], what: str) -> None:
        """Compare what a loaded network gives with what is expected.

        Args:
            infer: actions (n, A) for observations (n, D).
            names: of the actions.
            what: names the policy in the error.

        Raises:
            PolicyError: it is another network, or another order or scale of inputs or outputs.
        """
        given = np.asarray(self.observations, dtype=np.float64)
        expected = np.asarray(self.actions, dtype=np.float64)
        if expected.shape[1] != len(names):
            raise PolicyError(
                f"{what}: {GOLDEN_FILE} expects {expected.shape[1]} actions, the card names "
                f"{len(names)}; export the policy again"
            )
        found = infer(given)
        if found.shape != expected.shape:
            raise PolicyError(
                f"{what} gives actions of shape {found.shape} for golden observations of shape "
                f"{given.shape}, {GOLDEN_FILE} has {expected.shape}; export the policy again"
            )
        error = np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)
        if bool((error <= self.tolerance).all()):
            return
        row, column = np.unravel_index(
            int(np.argmax(np.where(np.isfinite(error), error, np.inf))), error.shape
        )
        raise PolicyError(
            f"{what} gives {names[column]} = {found[row, column]:.4g} for golden observation {row}, "
            f"{GOLDEN_FILE} says {expected[row, column]:.4g}: its inputs, outputs or normaliser are not "
            "those that it was trained with; export the policy again"
        )


def golden_observations(mean: Array, deviation: Array) -> Array:
    """Observations (n, D) over what the training saw; numbers that float32 holds exactly.

    Args:
        mean: (D,) of the normaliser.
        deviation: (D,) standard deviations of the normaliser.
    """
    rng = np.random.default_rng(0)
    drawn = rng.standard_normal((VECTOR_COUNT, len(mean)))
    single = np.asarray(mean + SPREAD_RATIO * deviation * drawn, dtype=np.float32)
    return single.astype(np.float64)


def write_golden_vectors(folder: Path, observations: Array, actions: Array) -> GoldenVectors:
    """Write the file beside a network.

    Args:
        folder: of the policy.
        observations: (n, D).
        actions: (n, A) that the trained network gives for them.
    """
    # float32 as its shortest decimal: what is read back is the same number.
    golden = GoldenVectors(
        observations=_rows(observations),
        actions=_rows(actions),
    )
    text = golden.model_dump_json(indent=1) + "\n"
    (folder / GOLDEN_FILE).write_text(text, encoding="utf-8")
    return golden


def read_golden_vectors(content: bytes, what: str) -> GoldenVectors:
    """Parse the file's content.

    Args:
        content: of ``golden_vectors.json``.
        what: names the policy in the error.

    Raises:
        PolicyError: it is not such a file.
    """
    try:
        return GoldenVectors.model_validate_json(content)
    except ValueError as error:
        cause = content_problems(error)
        raise PolicyError(f"{what}: {GOLDEN_FILE} cannot be used: {cause}") from error


def _rows(values: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(str(np.float32(v))) for v in row) for row in values)
