"""All that can be said about a policy version without a throw; the same on server, machine and desk."""

import math

from machine.errors import PolicyError
from machine.policy_card import GOLDEN_FILE, PolicyFiles
from machine.spec import MachineSpec
from runtime.control.policy import PolicyRunner


def check_version(files: PolicyFiles, spec: MachineSpec) -> PolicyRunner:
    """Load a version as a machine does, and refuse what a new version must not lack.

    Args:
        files: as they were read.
        spec: of the machine type that it is to throw with.

    Raises:
        PolicyError: the first thing that is wrong, and what to do.
    """
    if files.golden is None:
        raise PolicyError(
            f"{files.card.policy_id} has no {GOLDEN_FILE}; `python -m scripts.golden_vectors FOLDER` "
            "writes it for a policy that is known to be right"
        )
    _check_targets(files)
    return PolicyRunner(files, spec)


def _check_targets(files: PolicyFiles) -> None:
    card = files.card
    range_m = (card.target_range_min_m, card.target_range_max_m)
    height_m = (card.target_height_min_m, card.target_height_max_m)
    if not (all(map(math.isfinite, range_m)) and 0.0 < range_m[0] < range_m[1]):
        raise PolicyError(
            f"{card.policy_id}: its card names targets from {range_m[0]:g} to {range_m[1]:g} m, "
            "which is no range; export the policy again"
        )
    if not (all(map(math.isfinite, height_m)) and height_m[0] <= height_m[1]):
        raise PolicyError(
            f"{card.policy_id}: its card names heights from {height_m[0]:g} to {height_m[1]:g} m, "
            "which is no range; export the policy again"
        )
