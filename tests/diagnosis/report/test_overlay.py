"""Series for the report: the twin with what was found lies on what was measured, the one without does not."""

import numpy as np
import pytest

from diagnosis.hypotheses.gap_problem import pose_problem
from diagnosis.linearisation.parameters import layout
from diagnosis.loading.prepared import prepare
from diagnosis.report.overlay import overlay
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws

LATE = Effect(effect="valve_dead_time", joint="dipper", parameters={"extra_dead_time_s": 0.1})


@pytest.fixture(scope="module")
def problem():
    loaded = throws((LATE,), 4)
    known = health()
    plan = layout(known.noise)
    prepared = prepare(loaded.throws, profile())
    calibration = loaded.throws[0].calibration
    return pose_problem(prepared, profile(), calibration, known, plan)


def rms(plot, name):
    left = np.array(plot["measured"], float) - np.array(plot[name], float)
    return float(np.sqrt(np.nanmean(left**2)))


def test_after_fits_and_before_does_not(problem):
    plots = overlay(problem, (LATE,), ("actuation", "dipper"))
    names = list(plots)
    assert names[0] == "dipper velocity, throw 1"
    assert "dipper velocity, throw 4" in names
    for name, plot in plots.items():
        lengths = {len(plot[key]) for key in ("x", "measured", "twin_before", "twin_after")}
        assert len(lengths) == 1, name
    dipper = plots["dipper velocity, throw 1"]
    assert dipper["unit"] == "rad/s"
    assert rms(dipper, "twin_after") < 0.02
    assert rms(dipper, "twin_before") > 3.0 * rms(dipper, "twin_after")
    for name, limit in (("load's height in flight", 0.05), ("gripper's turn rate", 0.05)):
        plot = plots[f"{name}, throw 1"]
        assert rms(plot, "twin_after") < limit
        assert rms(plot, "twin_before") > 2.0 * rms(plot, "twin_after")


def first(problem, effects, where):
    return next(iter(overlay(problem, effects, where)))


def test_what_was_found_comes_first_and_without_it_the_place_to_look_at(problem):
    jitter = Effect(effect="release_jitter", parameters={"extra_sd_s": 0.01})
    assert first(problem, (jitter,), ("release", None)) == "height from measured joints, throw 1"
    drift = Effect(effect="warm_up_drift", joint="boom", parameters={"valve_lag.extra_lag_s": 0.05})
    assert first(problem, (drift,), ("actuation", "boom")) == "boom velocity, throw 1"
    imu = Effect(effect="imu_latency", parameters={"extra_latency_s": 0.05})
    assert first(problem, (imu,), ("aim", None)) == "turn rate from measured joints, throw 1"
    assert first(problem, (), ("swing", None)) == "gripper's turn rate, throw 1"
    assert first(problem, (), ("actuation", "telescope")) == "telescope velocity, throw 1"
    assert first(problem, (), None) == "slew velocity, throw 1"
    names = [name.split(",")[0] for name in overlay(problem, (LATE, imu), ("actuation", "dipper"))]
    assert list(dict.fromkeys(names))[:2] == ["dipper velocity", "gripper's turn rate"]


def test_what_drives_miss_does_not_hide_what_is_behind_them(problem):
    """The valve is late, and the release is looked at: the load flies as the measured joints throw it."""
    delay = Effect(effect="release_delay", parameters={"extra_delay_s": 0.1})
    own = overlay(problem, (delay,), ("release", None))
    height, rate = (
        own[f"{name} from measured joints, throw 1"] for name in ("height", "turn rate")
    )
    assert rms(height, "twin_before") < 0.03
    assert rms(height, "twin_after") > 5.0 * rms(height, "twin_before")
    assert rms(rate, "twin_before") < 0.05
    from_commands = overlay(problem, (LATE, delay), ("actuation", "dipper"))
    assert rms(from_commands["gripper's turn rate, throw 1"], "twin_before") > 0.2


def test_without_effects_there_is_no_after(problem):
    plots = overlay(problem, ())
    assert "twin_after" not in plots["slew velocity, throw 1"]
