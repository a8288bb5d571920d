"""Replays against the twin that made the recording: exact where they must be, refused where they cannot."""

import numpy as np
import pytest

from machine.errors import UsageError
from sim_twin.effects.effect import Effect
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import EFFECTS
from sim_twin.replay.replay import ReplayElement, ReplayInput, ReplayOutput, fly, replay
from tests.cases import each
from tests.sim_twin.twin_throw import CALIBRATION, OPENS_AT, PROFILE, TICKS, Recorded, record

ALL = (True, True, True, True)


@pytest.fixture(scope="module")
def plain() -> Recorded:
    return record()


def run(recorded: Recorded, *elements: ReplayElement) -> ReplayOutput:
    return replay([recorded.replay_input], elements, PROFILE, CALIBRATION)


def test_an_unmodified_twin_repeats_its_own_throw_exactly(plain: Recorded) -> None:
    out = run(plain, ReplayElement(0))
    given = plain.replay_input
    assert given.swing_rad is not None
    np.testing.assert_array_equal(out.joint_position_rad_m[0], given.position_rad_m)
    np.testing.assert_array_equal(out.joint_velocity_rad_m_per_s[0], given.velocity_rad_m_per_s)
    np.testing.assert_array_equal(out.passive_position_rad[0], given.swing_rad)
    np.testing.assert_array_equal(out.gyro_rad_per_s[0], plain.gyro)
    np.testing.assert_array_equal(out.accel_m_per_s2[0], plain.accel)
    np.testing.assert_array_equal(out.ball_position_m[0], plain.ball)
    np.testing.assert_array_equal(out.impact_m, plain.twin.payload.impact_m)
    assert out.release_t_s[0] == pytest.approx(0.01 * OPENS_AT + 0.258)


@each("joints", [ALL, (False, True, False, True)])
def test_measured_joints_move_as_measured_and_the_gripper_follows(
    plain: Recorded, joints: tuple[bool, bool, bool, bool]
) -> None:
    out = run(plain, ReplayElement(0, (), joints))
    given = plain.replay_input
    np.testing.assert_allclose(out.joint_position_rad_m[0], given.position_rad_m, atol=1e-9)
    np.testing.assert_allclose(out.passive_position_rad[0], given.swing_rad, atol=1e-5)
    np.testing.assert_allclose(out.impact_m, plain.twin.payload.impact_m, atol=1e-5)
    # At the end a measured joint has no next row.
    np.testing.assert_allclose(out.accel_m_per_s2[0, :-1], plain.accel[:-1], atol=1e-3)


def test_measured_positions_are_met_exactly_whatever_the_valves_do(plain: Recorded) -> None:
    still = plain.replay_input._replace(valve_ratio=np.zeros((TICKS, 4)))
    out = replay([still], [ReplayElement(0, (), ALL)], PROFILE, CALIBRATION)
    np.testing.assert_array_equal(out.joint_position_rad_m[0], still.position_rad_m)
    np.testing.assert_array_equal(out.joint_velocity_rad_m_per_s[0], still.velocity_rad_m_per_s)
    np.testing.assert_allclose(out.impact_m, plain.twin.payload.impact_m, atol=1e-5)


def test_noise_of_measured_positions_does_not_shake_the_gripper(plain: Recorded) -> None:
    """The gripper feels the differences of the velocities given, not of the positions."""
    given = plain.replay_input
    noise = 1e-3 * np.random.default_rng(0).standard_normal((TICKS, 4))
    noisy = given._replace(position_rad_m=given.position_rad_m + noise)
    out = replay([noisy], [ReplayElement(0, (), ALL)], PROFILE, CALIBRATION)
    np.testing.assert_allclose(out.passive_position_rad[0], given.swing_rad, atol=3e-3)
    assert np.abs(out.accel_m_per_s2[0, :-1] - plain.accel[:-1]).max() < 0.05


def test_a_measured_swing_and_opening_leave_only_the_flight(plain: Recorded) -> None:
    stiff = Effect(effect="passive_viscous_friction", parameters={"extra_viscous_per_s": 0.6})
    late = Effect(effect="release_delay", parameters={"extra_delay_s": 0.2})
    blown = Effect(effect="wind", parameters={"x_m_per_s": 5.0})
    measured = ReplayElement(0, (stiff, late), ALL, measured_swing=True, measured_opening=True)
    out = run(plain, measured, measured._replace(effects=(stiff, late, blown)))
    np.testing.assert_allclose(out.impact_m[0], plain.twin.payload.impact_m[0], atol=1e-9)
    assert out.impact_m[1, 0] > out.impact_m[0, 0] + 0.05


@each(
    "effect",
    [
        Effect(effect="joint_sensor_bias", joint="boom", parameters={"bias_rad_m": 0.05}),
        Effect(effect="joint_sensor_bias", joint="slew", parameters={"bias_rad_m": -0.05}),
        Effect(effect="joint_sensor_latency", joint="slew", parameters={"extra_latency_s": 0.05}),
        Effect(
            effect="joint_sensor_latency", joint="dipper", parameters={"extra_latency_s": 0.033}
        ),
        Effect(effect="base_tilt", parameters={"roll_rad": 0.05, "pitch_rad": -0.04}),
        Effect(effect="chassis_compliance", parameters={"pitch_rad": 0.04}),
        Effect(effect="gripper_length", parameters={"extra_length_m": 0.2}),
    ],
)
@each("joints", [(False,) * 4, ALL])
def test_the_true_hypothesis_explains_the_recording(
    effect: Effect, joints: tuple[bool, bool, bool, bool]
) -> None:
    """From valves and from measured motion: the effect that was there leads to what was seen."""
    recorded = record([effect])
    out = run(recorded, ReplayElement(0, (effect,), joints), ReplayElement(0, (), joints))
    given, impact = recorded.replay_input, recorded.twin.payload.impact_m[0]
    np.testing.assert_allclose(out.joint_position_rad_m[0], given.position_rad_m, atol=1e-3)
    np.testing.assert_allclose(out.gyro_rad_per_s[0], recorded.gyro, atol=0.02)
    np.testing.assert_allclose(out.impact_m[0], impact, atol=0.01)
    miss = np.linalg.norm(out.impact_m[1] - impact)
    seen = np.abs(out.joint_position_rad_m[1] - given.position_rad_m).max()
    assert miss > 0.03 or seen > 0.003, "without the effect it is not explained"


def test_drifts_follow_each_throws_place(plain: Recorded) -> None:
    drift = Effect(effect=DRIFT, parameters={"release_delay.extra_delay_s": 0.1})
    inputs = [plain.replay_input._replace(progress_ratio=place) for place in (0.0, 0.5, 1.0)]
    out = replay(inputs, [ReplayElement(i, (drift,)) for i in range(3)], PROFILE, CALIBRATION)
    np.testing.assert_allclose(np.diff(out.release_t_s), 0.05, atol=1e-9)


def test_the_profiles_own_effects_act_in_every_element(plain: Recorded) -> None:
    late = Effect(effect="release_delay", parameters={"extra_delay_s": 0.05})
    profile = PROFILE.model_copy(update={"effects": (late,)})
    out = replay(
        [plain.replay_input], [ReplayElement(0), ReplayElement(0, (late,))], profile, CALIBRATION
    )
    base = 0.01 * OPENS_AT + 0.258
    np.testing.assert_allclose(out.release_t_s, [base + 0.05, base + 0.10])


def test_nothing_in_a_replay_is_random(plain: Recorded) -> None:
    jitter = Effect(effect="release_jitter", parameters={"extra_sd_s": 0.1})
    out = run(plain, ReplayElement(0), ReplayElement(0, (jitter,)))
    np.testing.assert_array_equal(out.impact_m[0], out.impact_m[1])


def test_a_command_time_between_ticks_counts(plain: Recorded) -> None:
    given = plain.replay_input._replace(release_t_s=0.01 * OPENS_AT - 0.0037)
    out = replay([given], [ReplayElement(0)], PROFILE, CALIBRATION)
    assert out.release_t_s[0] == pytest.approx(0.01 * OPENS_AT - 0.0037 + 0.258)


def test_short_throws_end_in_nan_and_do_not_disturb_long_ones(plain: Recorded) -> None:
    given = plain.replay_input
    cut = 100
    short = ReplayInput(
        valve_ratio=given.valve_ratio[:cut],
        gripper_open=given.gripper_open[:cut],
        position_rad_m=given.position_rad_m[:cut],
        velocity_rad_m_per_s=given.velocity_rad_m_per_s[:cut],
        swing_start_rad=given.swing_start_rad,
        swing_rate_start_rad_per_s=given.swing_rate_start_rad_per_s,
    )
    out = replay([short, given], [ReplayElement(0), ReplayElement(1)], PROFILE, CALIBRATION)
    assert out.joint_position_rad_m.shape == (2, TICKS, 4)
    assert np.isnan(out.joint_position_rad_m[0, cut:]).all()
    assert np.isfinite(out.joint_position_rad_m[0, :cut]).all()
    assert np.isnan(out.release_t_s[0])
    assert np.isnan(out.impact_m[0]).all()
    np.testing.assert_array_equal(out.impact_m[1], plain.twin.payload.impact_m[0])


def test_an_impact_after_the_recording_is_still_found(plain: Recorded) -> None:
    given = plain.replay_input
    release = int(100.0 * float(given.opening_t_s)) + 2
    cut = given._replace(
        **{
            name: getattr(given, name)[:release]
            for name in (
                "valve_ratio",
                "gripper_open",
                "position_rad_m",
                "velocity_rad_m_per_s",
                "swing_rad",
                "swing_rate_rad_per_s",
            )
        }
    )
    out = replay([cut], [ReplayElement(0)], PROFILE, CALIBRATION)
    np.testing.assert_array_equal(out.impact_m, plain.twin.payload.impact_m)


def test_flying_the_release_state_alone_gives_the_replays_impact() -> None:
    effects = (
        Effect(effect="wind", parameters={"x_m_per_s": 3.0, "y_m_per_s": -2.0}),
        Effect(effect="release_spin", parameters={"spin_rad_per_s": 15.0}),
        Effect(effect="payload_mass", parameters={"extra_mass_kg": 0.4}),
        Effect(effect="sticky_release", parameters={"slowdown_ratio": 0.1}),
        Effect(effect="base_tilt", parameters={"pitch_rad": 0.05}),
    )
    recorded = record(effects, surface_m=0.3)
    out = run(recorded, ReplayElement(0, effects))
    flight = fly(
        out.release_position_m,
        out.release_velocity_m_per_s,
        PROFILE,
        [effects],
        surface_height_m=0.3,
    )
    np.testing.assert_allclose(flight.impact_m, recorded.twin.payload.impact_m, atol=1e-6)
    np.testing.assert_allclose(flight.flight_s, out.impact_t_s - out.release_t_s, atol=1e-6)
    np.testing.assert_allclose(flight.track_m[0, 0], out.release_position_m[0])
    assert np.isnan(flight.track_m[0, -1]).all()


def test_loads_without_a_release_state_do_not_fly() -> None:
    nothing = np.full((2, 3), np.nan)
    flight = fly(nothing, nothing, PROFILE)
    assert np.isnan(flight.impact_m).all()
    assert np.isnan(flight.flight_s).all()


def test_inputs_that_do_not_fit_are_refused(plain: Recorded) -> None:
    given = plain.replay_input
    bare = given._replace(swing_rad=None, opening_t_s=float("nan"))
    for throw, element, message in (
        (given._replace(valve_ratio=given.valve_ratio[:, :3]), ReplayElement(0), "valve_ratio"),
        (given._replace(position_rad_m=given.position_rad_m * np.nan), ReplayElement(0), "finite"),
        (given, ReplayElement(1), "names throw 1 of 1"),
        (bare, ReplayElement(0, measured_swing=True), "no swing_rad"),
        (bare, ReplayElement(0, measured_opening=True), "no opening_t_s"),
    ):
        with pytest.raises(UsageError, match=message):
            replay([throw], [element], PROFILE, CALIBRATION)
    with pytest.raises(UsageError, match="at least one element"):
        replay([given], [], PROFILE, CALIBRATION)


def test_the_whole_library_can_be_replayed_at_once(plain: Recorded) -> None:
    effects = [
        Effect(effect=name, joint=joint, parameters={p.name: p.step})
        for name, spec in EFFECTS.items()
        if name != DRIFT
        for joint in (spec.joints or (None,))
        for p in spec.parameters
    ]
    out = run(plain, *(ReplayElement(0, (effect,)) for effect in effects))
    assert np.isfinite(out.impact_m).all()
