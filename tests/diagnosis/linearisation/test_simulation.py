"""Shortened simulations against whole replays of the same throws."""

import numpy as np
import pytest

from diagnosis.linearisation.parameters import ReplayKind
from diagnosis.linearisation.simulation import Simulated, late, simulate
from diagnosis.linearisation.simulation_batch import ALL
from diagnosis.loading.prepared import IMU_UNTIL_AFTER_OPENING_S, PreparedThrow, prepare
from sim_twin.effects.effect import Effect
from sim_twin.replay.replay import ReplayElement, ReplayOutput, replay
from tests.diagnosis.twin_throws import profile, throws

EFFECTS = (
    (),
    (Effect(effect="wind", parameters={"x_m_per_s": 4.0}),),
    (Effect(effect="chassis_compliance", parameters={"pitch_rad": 0.02}),),
    (Effect(effect="joint_sensor_latency", joint="boom", parameters={"extra_latency_s": 0.1}),),
    (Effect(effect="imu_latency", parameters={"extra_latency_s": 0.1}),),
)


@pytest.fixture(scope="module")
def prepared() -> list[PreparedThrow]:
    return prepare(throws(count=3).throws, profile())


def both(prepared: list[PreparedThrow], view: ReplayKind) -> tuple[Simulated, ReplayOutput]:
    flight = view is ReplayKind.FLIGHT
    elements = [
        ReplayElement(1, effects, ALL, measured_swing=flight, measured_opening=flight)
        for effects in EFFECTS
    ]
    inputs, calibration = [p.input for p in prepared], prepared[0].throw.calibration
    short = simulate(inputs, elements, [view] * len(elements), profile(), calibration)
    return short, replay(inputs, elements, profile(), calibration)


def test_a_shortened_flight_ends_where_the_whole_one_does(prepared: list[PreparedThrow]) -> None:
    short, whole = both(prepared, ReplayKind.FLIGHT)
    np.testing.assert_allclose(short.impact_m, whole.impact_m, atol=1e-6)
    np.testing.assert_allclose(short.release_t_s, whole.release_t_s, atol=1e-9)
    for track, points in zip(short.ball, whole.ball_position_m, strict=True):
        assert track is not None
        at_s = track[0] + 0.01 * np.arange(track[1].shape[0])
        known = np.flatnonzero(np.isfinite(points[:, 0]))
        known = known[(0.01 * known >= at_s[0]) & (0.01 * known <= at_s[-1])]
        assert known.size > 20
        for axis in range(3):
            evaluated = np.interp(0.01 * known, at_s, track[1][:, axis])
            np.testing.assert_allclose(evaluated, points[known, axis], atol=3e-4)


def test_a_shortened_swing_is_the_same_while_it_is_compared(prepared: list[PreparedThrow]) -> None:
    short, whole = both(prepared, ReplayKind.SWING)
    ticks = int((prepared[1].input.opening_t_s + IMU_UNTIL_AFTER_OPENING_S) / 0.01)
    np.testing.assert_allclose(
        short.gyro_rad_per_s[:, :ticks], whole.gyro_rad_per_s[:, :ticks], atol=1e-9
    )


def test_a_late_sensor_reports_the_past() -> None:
    track = np.sin(0.3 * np.arange(50))
    np.testing.assert_allclose(late(track, 0.02)[2:], track[:-2])
    assert late(track, 0.0) is track


def test_early_motion_is_what_a_late_sensor_reported(prepared: list[PreparedThrow]) -> None:
    motion = prepared[0].motion
    reported = late(motion.velocity_rad_m_per_s[:, 2], 0.073)
    evaluated = motion.velocity_rad_m_per_s.copy()
    evaluated[:, 2] = reported
    found = motion._replace(velocity_rad_m_per_s=evaluated).early(np.array([0.0, 0.0, 0.073, 0.0]))
    inside = slice(10, -10)
    np.testing.assert_allclose(
        found.velocity_rad_m_per_s[inside], motion.velocity_rad_m_per_s[inside], atol=2e-3
    )
    assert motion.early(np.zeros(4)) is motion
