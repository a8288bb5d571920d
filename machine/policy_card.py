"""Card of a policy: inputs and outputs, targets, origin, accuracy."""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from machine.conventions import Mode
from machine.errors import PolicyError

POLICY_FILE = "policy.onnx"
CARD_FILE = "card.json"
GOLDEN_FILE = "golden_vectors.json"


class TrainingRecord(BaseModel):
    """How the policy came to be."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    commit: str
    seed_count: int
    """Seed of the training."""
    environment_step_count: int
    iteration_count: int
    wall_s: float
    device: str
    config: dict[str, Any]
    """Resolved configuration."""


class PolicyCard(BaseModel):
    """Contract of one policy version. The normaliser is inside the ONNX file.

    ONNX input ``observation`` float32 [batch, len(observation_names)], output ``action`` float32
    [batch, len(action_names)]; actions are clipped to [-1, 1] and scaled by ``action_scale_rad_m_per_s``,
    the last one is the release (opens above 0.9).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    schema_version: Literal[1] = 1
    policy_id: str = Field(pattern=r"^[a-z0-9][a-z0-9._-]{2,63}$")
    mode: Mode
    policy_sha256: str
    model_sha256: str
    policy_rate_hz: float = 12.5
    control_rate_hz: float = 100.0
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    action_scale_rad_m_per_s: tuple[float, ...]
    """Scale of each velocity action, same order as ``action_names`` without the release."""
    target_range_min_m: float
    target_range_max_m: float
    target_height_min_m: float = 0.0
    target_height_max_m: float = 0.0
    reach_at_height_m: tuple[tuple[float, float], ...] = ()
    """Pairs of height and largest range there, heights increasing, interpolated linearly; empty: the same
    range at every height."""
    training: TrainingRecord
    evaluation: list[dict[str, Any]] = []
    """Results of ``downrange evaluate``, appended after training."""


def add_evaluation(folder: Path, evaluation: dict[str, Any]) -> None:
    """Add a result of ``downrange evaluate`` to the card of a policy folder.

    Replaces an earlier result on the same plant and unit.

    Raises:
        PolicyError: the folder holds no policy whose file and card agree.
    """
    card = load_card(folder)
    same = ("plant", "unit_seed")
    kept = [e for e in card.evaluation if any(e.get(k) != evaluation[k] for k in same)]
    changed = card.model_copy(update={"evaluation": [*kept, evaluation]})
    part = folder / f"{CARD_FILE}.part"
    part.write_text(changed.model_dump_json(indent=2) + "\n", encoding="utf-8")
    part.replace(folder / CARD_FILE)


def file_sha256(path: Path) -> str:
    """sha256 of a file's bytes, hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True, slots=True)
class PolicyFiles:
    """The files of one version as they were read, once: what is checked is what is loaded."""

    folder: Path
    card: PolicyCard
    policy: bytes
    """Content of policy.onnx."""
    text: bytes
    """Content of card.json."""
    golden: bytes | None
    """Content of golden_vectors.json; None where there is none."""

    @property
    def card_sha256(self) -> str:
        """sha256 of card.json, hex."""
        return hashlib.sha256(self.text).hexdigest()

    @property
    def golden_sha256(self) -> str | None:
        """sha256 of golden_vectors.json, hex."""
        return None if self.golden is None else hashlib.sha256(self.golden).hexdigest()


def load_card(folder: Path) -> PolicyCard:
    """Read and check the card of a policy folder (card.json beside policy.onnx).

    Raises:
        PolicyError: as `read_policy`.
    """
    return read_policy(folder).card


def read_policy(folder: Path) -> PolicyFiles:
    """Read the files of a policy folder, and check that network and card agree.

    Raises:
        PolicyError: a file is missing, the card does not fit the schema, or its hash is not that of the
            ONNX file.
    """
    card_path, policy_path = folder / CARD_FILE, folder / POLICY_FILE
    for path in (card_path, policy_path):
        if not path.is_file():
            raise PolicyError(
                f"{path} is missing; a policy folder holds {POLICY_FILE}, {CARD_FILE} and {GOLDEN_FILE}"
            )
    try:
        policy, text = policy_path.read_bytes(), card_path.read_bytes()
        golden = _read_if_there(folder / GOLDEN_FILE)
    except OSError as error:
        raise PolicyError(f"{folder} cannot be read: {error}") from error
    return policy_of(folder, policy, text, golden)


def policy_of(folder: Path, policy: bytes, text: bytes, golden: bytes | None) -> PolicyFiles:
    """The version of these contents.

    Args:
        folder: where they lie; names them in errors.
        policy: content of policy.onnx.
        text: content of card.json.
        golden: content of golden_vectors.json; None without.

    Raises:
        PolicyError: a file is empty, the card does not fit the schema, or its hash is not that of the ONNX
            file.
    """
    card_path, policy_path = folder / CARD_FILE, folder / POLICY_FILE
    for name, content in ((POLICY_FILE, policy), (CARD_FILE, text), (GOLDEN_FILE, golden)):
        if content is not None and not content:
            raise PolicyError(f"{folder / name} is empty; copy the policy again")
    try:
        words = text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise PolicyError(
            f"{card_path} is no text in UTF-8 (byte {error.start}); save it as UTF-8"
        ) from error
    try:
        # Also numbers in fields of any content must be finite: no database holds others in JSON.
        json.loads(words, parse_constant=_finite, parse_float=_finite)
        card = PolicyCard.model_validate_json(text)
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"{card_path} is not a policy card: {content_problems(error)}") from error
    found = hashlib.sha256(policy).hexdigest()
    if found != card.policy_sha256:
        raise PolicyError(
            f"{policy_path} has sha256 {found[:12]}..., its card says {card.policy_sha256[:12]}...: "
            "the file was changed or cut off; copy the policy again"
        )
    return PolicyFiles(folder, card, policy, text, golden)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is no finite number")
    return value


def content_problems(error: Exception) -> str:
    """What is wrong with a file's content, a phrase a field.

    The library's own text spans lines and links to its manual.
    """
    if not isinstance(error, ValidationError):
        return str(error)
    problems = [
        f"{'.'.join(str(part) for part in one['loc']) or 'the file'}: {one['msg']}"
        for one in error.errors()
    ]
    return "; ".join(problems[:5])


def _read_if_there(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
