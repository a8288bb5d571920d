"""Detection limits of all faults that a challenge may hide, as measured by `challenge.limit_measurement`."""

import json
from pathlib import Path
from typing import Final

from machine.errors import UsageError

LIMITS_PATH: Final = Path(__file__).with_name("detection_limits.json")
"""Made by ``python -m challenge.limit_measurement``."""


def limit_key(effect: str, joint: str | None, parameter: str) -> str:
    """Name of a detection limit, ``effect.joint.parameter``."""
    return ".".join(part for part in (effect, joint, parameter) if part)


def load_limits(path: Path = LIMITS_PATH) -> dict[str, float]:
    """Detection limits by name, in the parameter's unit.

    Raises:
        UsageError: the file is missing or broken.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["limits"]
        return {str(name): float(size) for name, size in found.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"detection limits {path} cannot be read ({error}); "
            "make them with `python -m challenge.limit_measurement`"
        ) from error
