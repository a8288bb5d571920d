"""The model of a machine of another type."""

import numpy as np
import pytest

from diagnosis.healthy.noise import NoiseModel, load_noise
from diagnosis.healthy.sensor_noise import NOISE_LIKE_SD
from diagnosis.inference.evidence import Information, screen, weigh
from diagnosis.linearisation.parameters import index_of, layout, library
from diagnosis.population import other_machine_type
from diagnosis.population.other_machine_type import fitted_other_type_model, other_type_model
from diagnosis.tuning import DRIVE_RATIOS
from machine.conventions import ACTIVE_JOINTS, Array

LATE_SLEW = "joint_sensor_latency.slew.extra_latency_s"
FAR, NEAR = DRIVE_RATIOS[0], DRIVE_RATIOS[-1]
GAIN = tuple(f"valve_gain.dipper.{way}_ratio" for way in ("positive", "negative"))


@pytest.fixture
def two_ratios(monkeypatch: pytest.MonkeyPatch) -> None:
    """As far as the type, or near; nothing between."""
    monkeypatch.setattr(other_machine_type, "DRIVE_RATIOS", (FAR, NEAR))


def of_drives(ratio: float) -> NoiseModel:
    return other_type_model(load_noise(), [ratio] * len(ACTIVE_JOINTS))


def informed(sizes: Array, model: NoiseModel) -> Information:
    """Information of throws that determine every parameter (p,) to a twentieth of its scatter."""
    precision = np.diag(400.0 / np.diag(layout(model).priors.scatter))
    gradient = precision @ sizes
    square = float(sizes @ gradient)
    return Information(precision, gradient, square, 0.0)


def machine(ratio: float, **effect: float) -> Information:
    """Throws of a machine whose drives deviate by this, and by an effect."""
    model = of_drives(ratio)
    scatter = layout(model).priors.scatter
    sizes = np.random.default_rng(5).multivariate_normal(np.zeros(scatter.shape[0]), scatter)
    for key, size in effect.items():
        sizes[index_of()[key]] += size
    return informed(sizes, of_drives(FAR))


def gain_log_odds(model: NoiseModel, data: Information) -> float:
    plan = layout(model)
    group = plan.groups.index(("valve_gain", "dipper"))
    return weigh(screen(data, plan.priors), plan.priors, (group,)).log_odds


def test_it_has_its_own_deviations() -> None:
    model, found = load_noise(), of_drives(FAR)
    assert not found.healthy_mean
    for name in ("base_height.extra_height_m", "unmodelled.command.slew.third_ratio"):
        assert found.machine_scatter.sd_of(name) > model.machine_scatter.sd_of(name)
    for name, size in NOISE_LIKE_SD.items():
        assert found.machine_scatter.sd_of(name) > size


def test_all_clocks_may_be_late_together() -> None:
    found = of_drives(NEAR).machine_scatter
    covariance = found.covariance([LATE_SLEW, "imu_latency.extra_latency_s"])
    together, apart = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    assert together @ covariance @ together > 2.0 * (apart @ covariance @ apart)
    late = found.covariance([LATE_SLEW, "valve_dead_time.slew.extra_dead_time_s"])
    assert late[0, 1] < 0.0, "commands are as much earlier"


def test_dead_time_and_lag_deviate_with_opposite_signs() -> None:
    scatter = of_drives(NEAR).machine_scatter
    shape, delay = np.array([1.0, -1.0]), np.array([1.0, 1.0])
    for joint in ACTIVE_JOINTS:
        names = [f"valve_dead_time.{joint}.extra_dead_time_s", f"valve_lag.{joint}.extra_lag_s"]
        covariance = scatter.covariance(names)
        assert shape @ covariance @ shape > 2.0 * (delay @ covariance @ delay), joint


def test_the_ratio_narrows_the_drives_alone() -> None:
    near, far = of_drives(NEAR).machine_scatter, of_drives(FAR).machine_scatter
    for p in library():
        narrower = near.sd_of(p.key) < far.sd_of(p.key)
        assert narrower == (p.stage == "actuation" and p.joint is not None), p.key
        assert near.sd_of(p.key) >= p.tolerance
    name = "unmodelled.command.boom.second_ratio"
    assert near.sd_of(name) == far.sd_of(name), "another valve is metered in another way"


def test_the_ratio_is_fitted_to_the_throws(two_ratios: None) -> None:
    found = fitted_other_type_model(load_noise(), machine(FAR))
    assert found.machine_scatter == of_drives(FAR).machine_scatter


def test_an_effect_does_not_widen_the_model(two_ratios: None) -> None:
    data = machine(NEAR, **dict.fromkeys(GAIN, -0.2))
    found = fitted_other_type_model(load_noise(), data)
    assert found.machine_scatter == of_drives(NEAR).machine_scatter
    assert gain_log_odds(found, data) > gain_log_odds(of_drives(FAR), data) + 20.0


def test_one_deviating_joint_does_not_widen_the_model(two_ratios: None) -> None:
    model = of_drives(FAR)
    scatter = layout(model).priors.scatter
    far = np.random.default_rng(6).multivariate_normal(np.zeros(scatter.shape[0]), scatter)
    sizes = machine(NEAR)
    boom = np.zeros(scatter.shape[0])
    for p in library():
        if p.joint == "boom" and p.stage == "actuation":
            boom[index_of()[p.key]] = 5.0 * far[index_of()[p.key]]
    data = informed(np.linalg.solve(sizes.precision, sizes.gradient) + boom, model)
    assert (
        fitted_other_type_model(load_noise(), data).machine_scatter
        == of_drives(NEAR).machine_scatter
    )
