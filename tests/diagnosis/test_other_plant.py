"""Throws of a plant that shares no motion with the twin, read from CSV, judged without reference throws."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.diagnose import diagnose_throws
from diagnosis.loading.measured import white_noise_sd
from diagnosis.verdict import Diagnosis, VerdictKind
from machine.spec import load_spec
from sim_twin.twin.profile import nominal_profile
from tests.diagnosis.other_plant import Odd, throws


def diagnosed(folder: Path, odd: Odd, count: int = 6) -> Diagnosis:
    return diagnose_throws(throws(folder, odd, count), nominal_profile(load_spec()))


@pytest.mark.parametrize(
    "odd",
    [
        pytest.param(Odd(), id="as recorded"),
        pytest.param(Odd(noise_ratio=4.0), id="noisy joint sensors"),
        pytest.param(Odd(noise_ratio=0.02), id="quiet joint sensors"),
        pytest.param(Odd(filter_s=0.008), id="filtered joint sensors"),
        pytest.param(Odd(row_ticks=2), id="50 Hz"),
    ],
)
def test_a_healthy_stranger_has_no_cause(tmp_path: Path, odd: Odd) -> None:
    found = diagnosed(tmp_path, odd)
    assert found.verdict is VerdictKind.NONE, found.causes[:2]


def test_a_speed_limit_is_named_and_sized(tmp_path: Path) -> None:
    """In twelve throws: six leave it between a limit and a hysteresis, whichever their noise favours."""
    found = diagnosed(tmp_path, Odd(speed_reduction_ratio=(0.4, 0.0, 0.0, 0.0)), 12)
    (named,) = found.causes[0].effects
    assert (named.effect, named.joint) == ("speed_limit", "slew")
    assert named.parameters["reduction_ratio"].value == pytest.approx(0.4, abs=0.07)
    assert found.shrink is not None
    assert found.shrink.after_m < 0.5 * found.shrink.before_m
    assert found.shrink.ci90[0] > 0.8


def test_without_a_switch_the_flight_tells_a_late_release(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Odd(release_delay_s=0.08, has_switch=False))
    (named,) = found.causes[0].effects
    assert named.effect == "release_delay"
    assert named.parameters["extra_delay_s"].value == pytest.approx(0.08, abs=0.02)


def test_25_rows_a_second_are_enough(tmp_path: Path) -> None:
    """Their rate comes out as 24.9999 Hz, and was refused as less than 25."""
    loaded = throws(tmp_path, Odd(row_ticks=4), 3)
    assert len(loaded.throws) == 3, loaded.refused


def test_noise_is_told_from_motion(tmp_path: Path) -> None:
    for ratio in (1.0, 4.0):
        loaded = throws(tmp_path / str(ratio), Odd(noise_ratio=ratio), 3)
        shown = [white_noise_sd(throw.sensor_velocity_rad_m_per_s) for throw in loaded.throws]
        assert float(np.median(shown)) == pytest.approx(ratio * 5e-3, rel=0.15)
