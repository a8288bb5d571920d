"""A machine of another type may be off in its own way, but not further than its throws show."""

import numpy as np
import pytest

from diagnosis.healthy.noise import NoiseModel, load_noise
from diagnosis.healthy.sensor_noise import NOISE_LIKE_SD
from diagnosis.inference.evidence import Information, screen, weigh
from diagnosis.linearisation.parameters import index_of, layout, library
from diagnosis.population.other_machine_type import fitted_other_type_model, other_type_model
from diagnosis.tuning import DRIVE_RATIOS
from machine.conventions import ACTIVE_JOINTS, Array

LATE_SLEW = "joint_sensor_latency.slew.extra_latency_s"
FAR, NEAR = DRIVE_RATIOS[0], DRIVE_RATIOS[-1]
GAIN = tuple(f"valve_gain.dipper.{way}_ratio" for way in ("positive", "negative"))


def of_drives(ratio: float) -> NoiseModel:
    return other_type_model(load_noise(), [ratio] * len(ACTIVE_JOINTS))


def told(sizes: Array, model: NoiseModel) -> Information:
    """What throws say that tell every parameter (p,) to a twentieth of what a machine may be off by."""
    precision = np.diag(400.0 / np.diag(layout(model).priors.scatter))
    gradient = precision @ sizes
    square = float(sizes @ gradient)
    return Information(precision, gradient, square, 0.0, gradient, square)


def machine(ratio: float, **effect: float) -> Information:
    """Throws of a machine whose drives are off by this, and by an effect."""
    model = of_drives(ratio)
    scatter = layout(model).priors.scatter
    sizes = np.random.default_rng(5).multivariate_normal(np.zeros(scatter.shape[0]), scatter)
    for key, size in effect.items():
        sizes[index_of()[key]] += size
    return told(sizes, of_drives(FAR))


def gain_log_odds(model: NoiseModel, data: Information) -> float:
    plan = layout(model)
    group = plan.groups.index(("valve_gain", "dipper"))
    return weigh(screen(data, plan.priors), plan.priors, (group,)).log_odds


def test_it_may_be_off_in_its_own_way() -> None:
    model, found = load_noise(), of_drives(FAR)
    assert not found.healthy_mean
    for name in ("base_height.extra_height_m", "unmodelled.command.slew.third_ratio"):
        assert found.machine_scatter.sd_of(name) > model.machine_scatter.sd_of(name)
    for name, size in NOISE_LIKE_SD.items():
        assert found.machine_scatter.sd_of(name) > size


def test_all_clocks_may_be_late_together() -> None:
    """No log tells that, but which one is later than another."""
    found = of_drives(NEAR).machine_scatter
    covariance = found.covariance([LATE_SLEW, "imu_latency.extra_latency_s"])
    together, with_projection_subtracted = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    assert together @ covariance @ together > 2.0 * (
        with_projection_subtracted @ covariance @ with_projection_subtracted
    )
    late = found.covariance([LATE_SLEW, "valve_dead_time.slew.extra_dead_time_s"])
    assert late[0, 1] < 0.0, "commands are as much earlier"


@pytest.mark.parametrize("joint", ACTIVE_JOINTS)
def test_a_response_may_have_another_shape_and_not_another_delay(joint: str) -> None:
    names = [f"valve_dead_time.{joint}.extra_dead_time_s", f"valve_lag.{joint}.extra_lag_s"]
    covariance = of_drives(NEAR).machine_scatter.covariance(names)
    shape, delay = np.array([1.0, -1.0]), np.array([1.0, 1.0])
    assert shape @ covariance @ shape > 2.0 * (delay @ covariance @ delay)


def test_nearness_narrows_the_drives_alone() -> None:
    near, far = of_drives(NEAR).machine_scatter, of_drives(FAR).machine_scatter
    for p in library():
        narrower = near.sd_of(p.key) < far.sd_of(p.key)
        assert narrower == (p.stage == "actuation" and p.joint is not None), p.key
        assert near.sd_of(p.key) >= p.tolerance
    name = "unmodelled.command.boom.second_ratio"
    assert near.sd_of(name) == far.sd_of(name), "another valve is metered in another way"


@pytest.mark.parametrize("ratio", [NEAR, FAR])
def test_a_machine_is_as_near_as_its_throws_show(ratio: float) -> None:
    found = fitted_other_type_model(load_noise(), machine(ratio))
    assert found.machine_scatter == of_drives(ratio).machine_scatter


def test_an_effect_does_not_make_a_stranger_of_a_near_machine() -> None:
    data = machine(NEAR, **dict.fromkeys(GAIN, -0.2))
    found = fitted_other_type_model(load_noise(), data)
    assert found.machine_scatter == of_drives(NEAR).machine_scatter
    assert gain_log_odds(found, data) > gain_log_odds(of_drives(FAR), data) + 20.0


def test_a_joint_that_no_slope_explains_leaves_the_others_near() -> None:
    """Play or a limit shows in many slopes of its joint at once."""
    model = of_drives(FAR)
    scatter = layout(model).priors.scatter
    far = np.random.default_rng(6).multivariate_normal(np.zeros(scatter.shape[0]), scatter)
    sizes = machine(NEAR)
    boom = np.zeros(scatter.shape[0])
    for p in library():
        if p.joint == "boom" and p.stage == "actuation":
            boom[index_of()[p.key]] = 5.0 * far[index_of()[p.key]]
    data = told(np.linalg.solve(sizes.precision, sizes.gradient) + boom, model)
    assert (
        fitted_other_type_model(load_noise(), data).machine_scatter
        == of_drives(NEAR).machine_scatter
    )
