from pathlib import Path

import numpy as np
import pytest

from machine.calibration import nominal_calibration
from machine.conventions import Mode, Motion
from machine.errors import PlantError
from machine.kinematics import aligned_slew_rad
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner
from sim_twin.throws.rollout import Rollout
from sim_twin.twin.profile import exact_profile, nominal_profile
from sim_twin.twin.twin import Twin

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
TARGET = np.array([[6.0, 0.0, 0.0]])


def params(folder: Path, mode: Mode = Mode.PLANAR) -> ControlParams:
    runner = PolicyRunner(folder / f"swing-{mode.value}", SPEC)
    return ControlParams(spec=SPEC, calibration=CALIBRATION, mode=mode, policy=runner)


def start() -> np.ndarray:
    return safe_pose(float(aligned_slew_rad(SPEC, TARGET)[0]))[None]


def throw(folder: Path, count: int, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    twin = Twin(count=count, profile=nominal_profile(SPEC), calibration=CALIBRATION)
    rollout = Rollout(
        twin, params(folder), np.repeat(TARGET, count, 0), np.repeat(start(), count, 0), 3
    )
    motions = [rollout.motion[0]]
    for _ in range(ticks):
        rollout.tick()
        motions.append(rollout.motion[0])
    assert rollout.elapsed_s == pytest.approx(ticks * 0.01)
    return rollout.sample.impact_position_m, np.array(motions)


def test_a_throw_goes_from_throw_to_settle_and_lands(swing_policies: Path) -> None:
    impact, motions = throw(swing_policies, 1, 230)
    assert np.isfinite(impact).all()
    changes = motions[np.flatnonzero(np.diff(motions)) + 1]
    assert motions[0] == Motion.THROW
    assert changes.tolist() == [Motion.SETTLE]


def test_one_machine_throws_like_the_first_of_several(swing_policies: Path) -> None:
    """The policy's float32 sums depend on the batch; nothing else may."""
    alone, _ = throw(swing_policies, 1, 230)
    many, _ = throw(swing_policies, 3, 230)
    np.testing.assert_allclose(many[0], alone[0], atol=2e-4)
    assert np.abs(many[1] - many[0]).max() > 1e-3


def test_align_turns_the_cabin_and_then_throws(swing_policies: Path) -> None:
    target = np.array([[6.0, 1.0, 0.0]])
    profile = exact_profile(nominal_profile(SPEC)).model_copy(
        update={
            "dead_time_s": (0.06, 0.08, 0.08, 0.08),
            "natural_frequency_rad_per_s": (20.0, 20.0, 20.0, 20.0),
        }
    )
    twin = Twin(count=1, profile=profile, calibration=CALIBRATION)
    rollout = Rollout(twin, params(swing_policies), target, start(), 0, motion=Motion.ALIGN)
    while rollout.motion[0] == Motion.ALIGN and rollout.elapsed_s < 12.0:
        rollout.tick()
    assert rollout.motion[0] == Motion.THROW
    slew = twin.joint_position_rad_m[0, 0]
    assert slew == pytest.approx(float(aligned_slew_rad(SPEC, target)[0]), abs=0.005)


def test_targets_and_starts_must_fit_the_plant(swing_policies: Path) -> None:
    twin = Twin.for_plant(count=2, unit_seed=0)
    with pytest.raises(PlantError, match="2 machines"):
        Rollout(twin, params(swing_policies), TARGET, start(), 0)


def test_a_plant_that_does_not_follow_the_clock_is_caught(swing_policies: Path) -> None:
    class Lazy(Twin):
        def advance(self, until_ns: int) -> None:
            super().advance(until_ns - 1)

    lazy = Lazy(count=1, profile=nominal_profile(SPEC), calibration=CALIBRATION)
    rollout = Rollout(lazy, params(swing_policies), TARGET, start(), 0)
    with pytest.raises(PlantError, match="must follow `advance` exactly"):
        rollout.tick()
