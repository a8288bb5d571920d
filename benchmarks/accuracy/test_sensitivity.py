"""Sensitivities of an evaluation are measured throw by throw."""

from pathlib import Path

import numpy as np

from evaluation.sensitivity import FACTORS, measure_sensitivity
from machine.calibration import nominal_calibration
from machine.conventions import Mode
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import nominal_profile
from sim_twin.twin.twin import Twin
from tests.conftest import write_swing_policy

SPEC = load_spec()


def test_a_longer_release_delay_shifts_each_throw_alike(tmp_path: Path) -> None:
    write_swing_policy(tmp_path / "swing-2d", Mode.PLANAR)
    params = ControlParams(
        SPEC,
        nominal_calibration(SPEC),
        Mode.PLANAR,
        PolicyRunner(tmp_path / "swing-2d", SPEC),
    )
    profile = nominal_profile(SPEC)

    def make(count: int, effects: tuple[Effect, ...]) -> Twin:
        own = profile.model_copy(update={"effects": effects})
        return Twin(count=count, profile=own, calibration=params.calibration)

    starts = np.tile(safe_pose(), (8, 1))
    target = np.tile([6.0, 0.0, 0.0], (8, 1))
    shifts = measure_sensitivity(make, params, target, starts, 1)
    assert [s.name for s in shifts] == [f.name for f in FACTORS]
    delay = shifts[0]
    assert delay.pair_count + delay.failed_count == 8
    # Later is further on an upward swing, and the reverse; far clearer than the scatter of 8 throws.
    assert delay.low_m * delay.high_m < 0.0
    width = delay.high_ci95_m[1] - delay.high_ci95_m[0]
    assert width < 2.0 * abs(delay.high_m)
