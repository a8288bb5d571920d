"""Residuals vanish on throws of the twin itself, and slopes agree with a second simulation."""

import numpy as np
import pytest

from diagnosis.healthy.filters import HealthyModel, nothing
from diagnosis.linearisation.parameters import ReplayKind, index_of, library
from diagnosis.linearisation.sensitivities import LinearThrow, linearise, relinearise
from diagnosis.loading.prepared import PreparedThrow, prepare
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws


def linear(
    effects: tuple[Effect, ...] = (), count: int = 2
) -> tuple[list[PreparedThrow], list[LinearThrow]]:
    loaded = throws(effects, count)
    prepared = prepare(loaded.throws, profile())
    calibration = loaded.throws[0].calibration
    return prepared, linearise(prepared, profile(), calibration, health().filters)


@pytest.fixture(scope="module")
def own() -> tuple[list[PreparedThrow], list[LinearThrow]]:
    return linear()


def test_throws_of_the_twin_leave_noise(own: tuple[list[PreparedThrow], list[LinearThrow]]) -> None:
    prepared, found = own
    for p, one in zip(prepared, found, strict=True):
        for joint in ("slew", "boom", "dipper", "telescope"):
            block = p.block(f"actuation.{joint}")
            assert block is not None
            assert np.std(one.residual[block.rows]) < 0.006
        ball, gyro = p.block("flight.ball"), p.block("swing.gyro.y")
        assert ball is not None
        assert gyro is not None
        assert np.nanstd(one.residual[ball.rows]) < 0.05
        assert np.std(one.residual[gyro.rows]) < 0.03


def test_throws_can_be_linearised_one_by_one(
    own: tuple[list[PreparedThrow], list[LinearThrow]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("diagnosis.linearisation.sensitivities.THROWS_COUNT", 1)
    for together, alone in zip(own[1], linear()[1], strict=True):
        np.testing.assert_allclose(together.residual, alone.residual, atol=1e-9)
        np.testing.assert_allclose(together.jacobian, alone.jacobian, atol=1e-6)


def test_a_joint_effect_moves_its_own_joint_only(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, found = own
    column = index_of()["valve_lag.boom.extra_lag_s"]
    moved = {
        block.name
        for block in prepared[0].blocks
        if np.abs(found[0].jacobian[block.rows, column]).max() > 0.0
    }
    assert moved == {"actuation.boom"}


def test_every_parameter_moves_something_in_its_views_alone(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, found = own
    for i, parameter in enumerate(library()):
        stages = {
            block.name.split(".")[0]
            for block in prepared[0].blocks
            if np.abs(found[0].jacobian[block.rows, i]).max() > 1e-9
        }
        views = {str(v) for v in parameter.views} or {"release"}
        assert stages <= views, parameter.key


def test_slope_predicts_the_residual_of_a_small_effect(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    size = 0.02
    prepared, found = own
    _, moved = linear((Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": size}),))
    block = prepared[0].block("actuation.boom")
    assert block is not None
    slope = found[0].jacobian[block.rows, index_of()["valve_lag.boom.extra_lag_s"]]
    change = moved[0].residual[block.rows] - found[0].residual[block.rows]
    estimate = float(slope @ change / (slope @ slope))
    assert estimate == pytest.approx(size, rel=0.25)


def test_relinearised_at_the_truth_leaves_noise() -> None:
    effect = Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": 0.2})
    loaded = throws((effect,), 2)
    prepared = prepare(loaded.throws, profile())
    calibration = loaded.throws[0].calibration
    filters = health().filters
    first = linearise(prepared, profile(), calibration, filters)
    wanted = [p for p in library() if p.group == ("valve_lag", "boom")]
    again = next(
        relinearise(prepared, profile(), calibration, filters, first, [((effect,), wanted)])
    )
    block = prepared[0].block("actuation.boom")
    other = prepared[0].block("swing.gyro.y")
    assert block is not None
    assert other is not None
    assert np.std(first[0].residual[block.rows]) > 0.02
    assert np.std(again[0].residual[block.rows]) < 0.006
    # What an effect of a valve cannot move was not simulated again.
    np.testing.assert_array_equal(again[0].residual[other.rows], first[0].residual[other.rows])


def test_slopes_of_a_joint_with_a_late_valve_are_late(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    delay_s = 0.1
    late = Effect(effect="valve_dead_time", joint="boom", parameters={"extra_dead_time_s": delay_s})
    prepared, first = own
    calibration = prepared[0].throw.calibration
    wanted = [p for p in library() if p.group == (late.effect, late.joint)]
    args = (prepared, profile(), calibration, health().filters, first, [((late,), wanted)])
    block = prepared[0].block("actuation.boom")
    assert block is not None
    lag = index_of()["valve_lag.boom.extra_lag_s"]
    before = first[0].jacobian[block.rows, lag]
    after = next(relinearise(*args))[0].jacobian[block.rows, lag]
    expected = np.interp(block.t_s - delay_s, block.t_s, before)
    off = float(np.linalg.norm(after - expected))
    assert off < 0.25 * np.linalg.norm(after)
    assert off < 0.6 * np.linalg.norm(after - before)
    # A preview takes the slopes of "no effect".
    preview = next(relinearise(*args, followed=()))[0].jacobian[block.rows, lag]
    np.testing.assert_array_equal(preview, before)


def test_a_parameter_wanted_twice_is_perturbed_once(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, first = own
    calibration = prepared[0].throw.calibration
    slack = Effect(effect="valve_gain", joint="boom", parameters={"positive_ratio": -0.1})
    wanted = [p for p in library() if p.group == ("valve_gain", "boom")]
    args = (prepared, profile(), calibration, health().filters, first)
    once = next(relinearise(*args, [((slack,), wanted)]))[0].jacobian
    twice = next(relinearise(*args, [((slack,), [*wanted, *wanted])]))[0].jacobian
    assert np.abs(once[:, index_of()["valve_gain.boom.positive_ratio"]]).max() > 0.0
    np.testing.assert_allclose(twice, once, atol=1e-9)


def test_a_sensor_bias_keeps_the_slopes_of_no_effect(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, first = own
    calibration = prepared[0].throw.calibration
    of_load = np.r_[*(b.rows for b in prepared[0].blocks if b.name.startswith(("swing", "flight")))]
    for effect, joint, size, is_kept in (
        ("joint_sensor_bias", "dipper", 0.04, True),
        ("gripper_length", None, 0.2, False),
    ):
        wanted = [p for p in library() if p.group == (effect, joint)]
        moved = Effect(effect=effect, joint=joint, parameters={wanted[0].name: size})
        args = (prepared, profile(), calibration, health().filters, first)
        again = next(relinearise(*args, [((moved,), wanted)]))[0]
        column = index_of()[wanted[0].key]
        before, after = (one.jacobian[of_load, column] for one in (first[0], again))
        assert np.nanmax(np.abs(again.change[of_load])) > 0.02
        assert np.array_equal(after, before) == is_kept


def test_slopes_of_the_swing_are_updated_on_request(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, first = own
    longer = Effect(effect="gripper_length", joint=None, parameters={"extra_length_m": 0.25})
    wanted = [p for p in library() if p.group == (longer.effect, longer.joint)]
    calibration = prepared[0].throw.calibration
    args = (prepared, profile(), calibration, health().filters, first, [((longer,), wanted)])
    gyro = prepared[0].block("swing.gyro.y")
    assert gyro is not None
    viscous = index_of()["passive_viscous_friction.extra_viscous_per_s"]
    before, usual, followed = (
        one.jacobian[gyro.rows, viscous]
        for one in (
            first[0],
            next(relinearise(*args))[0],
            next(relinearise(*args, followed=(ReplayKind.SWING,)))[0],
        )
    )
    np.testing.assert_array_equal(usual, before)
    step = 0.05
    thick = Effect(
        effect="passive_viscous_friction", joint=None, parameters={"extra_viscous_per_s": step}
    )
    both = next(relinearise(*args[:5], [((longer, thick), wanted)]))[0]
    change = next(relinearise(*args))[0].residual[gyro.rows] - both.residual[gyro.rows]
    off = [float(np.linalg.norm(change / step - slope)) for slope in (before, followed)]
    assert off[1] < 0.5 * off[0]


def test_a_late_imu_reports_slopes_of_the_swing_late(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    late = Effect(effect="imu_latency", parameters={"extra_latency_s": 0.06})
    prepared, first = own
    calibration = prepared[0].throw.calibration
    args = (prepared, profile(), calibration, health().filters, first)
    alone = [p for p in library() if p.effect == "imu_latency"]
    both = [p for p in library() if p.effect in ("imu_latency", "gripper_length")]
    column = index_of()["gripper_length.extra_length_m"]
    shifted = next(relinearise(*args, [((late,), alone)]))[0].jacobian[:, column]
    simulated = next(relinearise(*args, [((late,), both)]))[0].jacobian[:, column]
    for name in ("swing.gyro.y", "swing.accel.x"):
        block = prepared[0].block(name)
        assert block is not None
        true, found = simulated[block.rows], shifted[block.rows]
        none = first[0].jacobian[block.rows, column]
        assert np.linalg.norm(found - true) < 0.15 * np.linalg.norm(true), name
        assert np.linalg.norm(none - true) > 0.2 * np.linalg.norm(true), name


def test_delay_of_the_opening_shows_at_the_switch() -> None:
    effect = Effect(effect="release_delay", parameters={"extra_delay_s": 0.05})
    prepared, late = linear((effect,))
    block = prepared[0].block("release.switch")
    assert block is not None
    assert late[0].residual[block.rows][0] == pytest.approx(0.05, abs=1e-6)
    assert ReplayKind.FLIGHT not in library()[index_of()["release_delay.extra_delay_s"]].views


def test_a_delay_of_the_opening_needs_no_simulation(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, found = own
    late = Effect(effect="release_delay", parameters={"extra_delay_s": 0.08})
    calibration = prepared[0].throw.calibration
    wanted = [p for p in library() if p.effect == "release_delay"]
    args = (prepared, profile(), calibration, health().filters, found, [((late,), wanted)])
    for p, before, after in zip(prepared, found, next(relinearise(*args)), strict=True):
        switch = p.block("release.switch")
        assert switch is not None
        moved = before.residual - after.residual
        assert moved[switch.rows] == pytest.approx([0.08])
        moved[switch.rows] = 0.0
        np.testing.assert_array_equal(np.nan_to_num(moved), 0.0)


DIPPER_VELOCITY_COLUMN = 14
"""Of the inputs of the boom's healthy filter: 9 of its own, 5 of the slew, then the dipper's velocity."""
DIPPER_WEIGHT_RATIO = 0.1


def boom_moves_with_the_dipper() -> HealthyModel:
    """Every healthy boom deviates from its twin by a tenth of the dipper's velocity."""
    slew, boom, *rest = nothing().joints
    weight = list(boom.weight)
    weight[DIPPER_VELOCITY_COLUMN] = DIPPER_WEIGHT_RATIO
    moved = boom.model_copy(update={"weight": tuple(weight)})
    return HealthyModel(note="the boom moves with the dipper", joints=(slew, moved, *rest))


def test_healthy_filters_use_the_motion_before_a_sensor_s_latency(
    own: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, on_time = own
    late = Effect(
        effect="joint_sensor_latency", joint="dipper", parameters={"extra_latency_s": 0.13}
    )
    loaded = throws((late,), len(prepared))
    calibration, filters = loaded.throws[0].calibration, boom_moves_with_the_dipper()
    late_prepared = prepare(loaded.throws, profile())
    wanted = [p for p in library() if p.group == (late.effect, late.joint)]
    first = linearise(late_prepared, profile(), calibration, filters)
    args = (late_prepared, profile(), calibration, filters, first, [((late,), wanted)])
    expected = linearise(prepared, profile(), calibration, filters)
    block = prepared[0].block("actuation.boom")
    assert block is not None
    for before, as_late, as_known, true in zip(
        on_time, first, next(relinearise(*args)), expected, strict=True
    ):
        moved = np.std(before.residual[block.rows] - true.residual[block.rows])
        wrong = np.std(as_late.residual[block.rows] - true.residual[block.rows])
        left = np.std(as_known.residual[block.rows] - true.residual[block.rows])
        assert wrong > 0.3 * moved
        assert left < 0.1 * wrong
