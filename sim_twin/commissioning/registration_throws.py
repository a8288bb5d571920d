"""Registration throws of a simulated machine with a policy, and their surveyed misses."""

from typing import NamedTuple

import numpy as np

from machine.conventions import Array, Mode, wrap_angle_rad
from machine.errors import UsageError
from machine.kinematics import aligned_slew_rad
from machine.policy_card import PolicyCard
from machine.reach import MIN_RANGE_M, reach_m
from machine.registration import Registration, TermKind
from machine.spec import MachineSpec
from machine.starts import safe_pose, sample_starts
from runtime.control.control_loop import ControlParams
from runtime.driver import SimulatedDriver
from sim_twin.commissioning.registration_fit import Surveyed, register
from sim_twin.throws.campaign import ThrowOutcome, run_throws
from sim_twin.throws.plant_abilities import HasSurface
from sim_twin.throws.throw_start import scattered_starts
from sim_twin.twin.profile import nominal_profile

FLAT_THROW_COUNT = 160
"""Throws with a policy for ground level only."""
GROUND_THROW_COUNT, RAISED_THROW_COUNT = 120, 120
"""Throws at ground level with a policy that was trained for other heights too."""
FIRST_RANGE_M = 6.0
NEAR_TARGET_RAD = 0.1
SPREAD_RATIO = 0.6180339887
"""Golden ratio: its multiples, modulo 1, fill an interval evenly for any number of them."""


class _Plan(NamedTuple):
    """Targets of the registration throws."""

    target_m: Array
    """(N, 3)"""
    kinds: tuple[TermKind, ...]
    """Terms that these throws can identify."""


def registration_throw_count(card: PolicyCard) -> int:
    """Number of throws for a registration of this policy."""
    return GROUND_THROW_COUNT + RAISED_THROW_COUNT if _is_raised(card) else FLAT_THROW_COUNT


def register_machine(
    plant: SimulatedDriver,
    params: ControlParams,
    spec: MachineSpec,
    seed: int = 0,
    *,
    on_ground_only: bool = False,
) -> Registration:
    """Throw at ranges over the whole reach and at the policy's heights, and fit a registration.

    A plant without `set_surface_height` has ground only: its registration then has no terms of height.

    Args:
        plant: copies of the machine; `plant.count` throws run side by side.
        params: parameters of the control step with the policy; registrations in the calibration are ignored.
        spec: machine type.
        seed: seed of starts and of the plant's noise.
        on_ground_only: throw at ground level even if the plant has heights, as a twin of a machine without.

    Raises:
        UsageError: no policy, no throw landed, or the misses are beyond the largest correction.
    """
    if params.policy is None:
        raise UsageError("a registration needs a policy")
    card = params.policy.card
    plan = _plan(card, at_heights=isinstance(plant, HasSurface) and not on_ground_only)
    unregistered = ControlParams(
        spec, params.calibration.without_registrations(), params.mode, params.policy
    )
    starts = _starts(spec, params.mode, plan.target_m, np.random.default_rng((seed, 0x4E6)))
    results = run_throws(plant, unregistered, plan.target_m, starts, seed)
    landed = np.array([result.outcome is ThrowOutcome.LANDED for result in results])
    miss_m = np.array([(r.downrange_error_m, r.crossrange_error_m) for r in results])[landed]
    turn = np.asarray(wrap_angle_rad(-starts[landed, 0]))
    throws = Surveyed(
        plan.target_m[landed, 0], plan.target_m[landed, 2], turn, miss_m[:, 0], miss_m[:, 1]
    )
    try:
        return register(card.policy_sha256, throws, plan.kinds)
    except ValueError as error:
        raise UsageError(
            f"registration with {card.policy_id}: {error} "
            f"({int(landed.sum())} of {len(results)} throws landed)"
        ) from error


def _is_raised(card: PolicyCard) -> bool:
    return card.target_height_max_m > card.target_height_min_m


def _plan(card: PolicyCard, *, at_heights: bool) -> _Plan:
    """Targets on the x axis, spread evenly over the policy's reach."""
    raised = at_heights and _is_raised(card)
    nearest = max(FIRST_RANGE_M, card.target_range_min_m, MIN_RANGE_M[card.mode])
    ground = GROUND_THROW_COUNT if raised else FLAT_THROW_COUNT
    target_m = np.zeros((ground + RAISED_THROW_COUNT if raised else ground, 3))
    target_m[:ground, 0] = np.linspace(nearest, card.target_range_max_m, ground)
    kinds = (TermKind.NEAR, TermKind.TURN) if card.mode is Mode.SPATIAL else ()
    if not raised:
        return _Plan(target_m, kinds)
    lowest, highest = card.target_height_min_m, card.target_height_max_m
    heights = np.linspace(lowest, highest, RAISED_THROW_COUNT)
    share = (SPREAD_RATIO * np.arange(RAISED_THROW_COUNT)) % 1.0
    farthest = np.array([reach_m(card, float(height)) for height in heights])
    target_m[ground:, 0] = nearest + share * (farthest - nearest)
    target_m[ground:, 2] = heights
    return _Plan(target_m, (*kinds, TermKind.HEIGHT, TermKind.HEIGHT_SQUARED))


def _starts(spec: MachineSpec, mode: Mode, target_m: Array, rng: np.random.Generator) -> Array:
    """Start poses (N, 6): half are the safe pose, as in operation, half are random, as in an evaluation.

    In 3D the cabin is near the target in starts from the safe pose: operators mostly throw repeatedly in one
    direction, and the mean miss depends on whether the throw begins with a turn.
    """
    count = target_m.shape[0]
    starts = sample_starts(spec, mode, target_m, rng)
    rested = scattered_starts(spec, nominal_profile(spec).spread, safe_pose(), count, rng)
    if mode is Mode.PLANAR:
        rested[:, 0] += aligned_slew_rad(spec, target_m)
    else:
        rested[:, 0] = rng.uniform(-NEAR_TARGET_RAD, NEAR_TARGET_RAD, count)
    starts[::2] = rested[::2]
    return starts
