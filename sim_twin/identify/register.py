"""Registration throws: how far a simulated machine misses with a policy at each range, by its own survey."""

import numpy as np

from machine.conventions import Array, Mode
from machine.errors import UsageError
from machine.kinematics import aligned_slew_rad
from machine.registration import Registration, register
from machine.spec import MachineSpec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.driver import SimulatedDriver
from sim_twin.throws.campaign import Outcome, run_throws
from sim_twin.throws.throw_start import scattered_starts
from sim_twin.twin.profile import nominal_profile

FIRST_RANGE_M, LAST_RANGE_M, RANGE_STEP_M = 6.0, 10.75, 0.25
THROWS_AT_RANGE = 8
NEAR_TARGET_RAD = 0.1
REGISTRATION_THROW_COUNT = THROWS_AT_RANGE * (
    1 + round((LAST_RANGE_M - FIRST_RANGE_M) / RANGE_STEP_M)
)


def register_machine(
    plant: SimulatedDriver, params: ControlParams, spec: MachineSpec, seed: int = 0
) -> Registration:
    """Throw from the safe pose at ranges over the whole reach.

    Args:
        plant: the machine, copied; takes the throws `plant.count` at a time.
        params: its control step with the policy; registrations in the calibration are left out.
        spec: machine type.
        seed: of starts and of the plant's noise.

    Raises:
        UsageError: no policy, no throw landed, or the misses are too large to aim away.
    """
    if params.policy is None:
        raise UsageError("a registration needs a policy")
    ranges_m = np.arange(FIRST_RANGE_M, LAST_RANGE_M + 0.5 * RANGE_STEP_M, RANGE_STEP_M)
    target_m = np.zeros((REGISTRATION_THROW_COUNT, 3))
    target_m[:, 0] = np.repeat(ranges_m, THROWS_AT_RANGE)
    bare = ControlParams(
        spec, params.calibration.without_registrations(), params.mode, params.policy
    )
    starts = _starts(spec, params.mode, target_m, np.random.default_rng((seed, 0x4E6)))
    results = run_throws(plant, bare, target_m, starts, seed)
    landed = np.array([result.outcome is Outcome.LANDED for result in results])
    miss_m = np.array([(r.downrange_error_m, r.crossrange_error_m) for r in results])[landed]
    try:
        return register(
            params.policy.card.policy_sha256, target_m[landed, 0], miss_m[:, 0], miss_m[:, 1]
        )
    except ValueError as error:
        raise UsageError(
            f"registration with {params.policy.card.policy_id}: {error} "
            f"({int(landed.sum())} of {len(results)} throws landed)"
        ) from error


def _starts(spec: MachineSpec, mode: Mode, target_m: Array, rng: np.random.Generator) -> Array:
    """The safe pose, in which every throw of an operator begins.

    In 3D the cabin stands anywhere in every other throw, and near the target in the rest: operators mostly
    throw again where they have just thrown, and the mean miss differs between the two.
    """
    count = target_m.shape[0]
    spread = nominal_profile(spec).spread
    starts = scattered_starts(spec, spread, safe_pose(), count, rng)
    if mode is Mode.PLANAR:
        starts[:, 0] += aligned_slew_rad(spec, target_m)
    else:
        starts[:, 0] = rng.uniform(-np.pi, np.pi, count)
        starts[::2, 0] = rng.uniform(-NEAR_TARGET_RAD, NEAR_TARGET_RAD, starts[::2].shape[0])
    return starts
