"""Each actuation effect against what its definition says, on the response alone."""

import numpy as np
import pytest

from machine.calibration import actuator_ratio, nominal_calibration
from machine.conventions import Array
from machine.spec import load_spec
from sim_twin.effects.arrays import effect_arrays
from sim_twin.effects.effect import Effect
from sim_twin.effects.valve_effects import SLIP_S, drive_flows
from sim_twin.rigid_body.arm_load import gravity_load_ratio, tipping_ratio
from sim_twin.rigid_body.model import twin_model
from sim_twin.twin.profile import exact_profile, nominal_profile
from sim_twin.twin.response import VelocityResponse
from tests.cases import each

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
PROFILE = exact_profile(nominal_profile(SPEC))
MIDDLE = np.array([[0.0, 0.5, 0.0, 0.5]])
SLEW, BOOM, DIPPER, TELESCOPE = range(4)


def drive(
    valve: Array,
    *effects: Effect,
    position: Array = MIDDLE,
    dead_s: float | None = None,
    seen: Array | None = None,
) -> Array:
    """Joint velocities (T, 4) for valve commands (T, 4) at a position that stays; as seen (T, 4)."""
    profile = (
        PROFILE if dead_s is None else PROFILE.model_copy(update={"dead_time_s": (dead_s,) * 4})
    )
    arrays = effect_arrays(1, (), [effects], 0.0)
    response = VelocityResponse(SPEC, profile, CALIBRATION, 1, arrays)
    response.reset(np.zeros((1, 3, 4)))
    measured = [None] * len(valve) if seen is None else [row[None] for row in seen]
    return np.stack(
        [
            response.step(row[None], position, now)[0].copy()
            for row, now in zip(valve, measured, strict=True)
        ]
    )


def effect(name: str, joint: str | None = "telescope", **parameters: float) -> Effect:
    return Effect(effect=name, joint=joint, parameters=parameters)


def step_command(size: float, joint: int = TELESCOPE, ticks: int = 400) -> Array:
    valve = np.zeros((ticks, 4))
    valve[:, joint] = size
    return valve


def steady(
    size: float, *effects: Effect, joint: int = TELESCOPE, position: Array = MIDDLE
) -> float:
    return float(drive(step_command(size, joint), *effects, position=position)[-1, joint])


@each("extra_s", [-0.05, 0.013, 0.3])
def test_extra_dead_time_shifts_the_motion(extra_s: float) -> None:
    late = drive(step_command(0.5), effect("valve_dead_time", extra_dead_time_s=extra_s))
    travelled = 0.01 * (drive(step_command(0.5)) - late).sum(axis=0)[TELESCOPE]
    assert travelled / steady(0.5) == pytest.approx(extra_s, abs=2e-4)


def test_dead_time_cannot_become_negative() -> None:
    gone = drive(step_command(0.5), effect("valve_dead_time", extra_dead_time_s=-0.1), dead_s=0.05)
    np.testing.assert_array_equal(gone, drive(step_command(0.5), dead_s=0.0))


@each("extra_s", [0.02, 0.6])
def test_an_extra_lag_is_a_first_order_lag_of_the_spool(extra_s: float) -> None:
    command = step_command(0.5)
    # Mean over each tick of 1 - exp(-t / T).
    ends = np.exp(-0.01 * np.arange(command.shape[0] + 1) / extra_s)
    spool = command * (1.0 + np.diff(ends) * extra_s / 0.01)[:, None]
    slow = drive(command, effect("valve_lag", extra_lag_s=extra_s))
    np.testing.assert_allclose(slow, drive(spool), atol=1e-12)
    plain = drive(command)[:, TELESCOPE].max()
    assert slow[:, TELESCOPE].max() <= plain * (1.0 + 1e-9), "a lag must not ring"


def test_a_lag_that_is_taken_away_shortens_the_mean_delay() -> None:
    fast = drive(step_command(0.5, ticks=900), effect("valve_lag", extra_lag_s=-0.05))
    travelled = 0.01 * (drive(step_command(0.5, ticks=900)) - fast).sum(axis=0)[TELESCOPE]
    assert travelled / steady(0.5) == pytest.approx(-0.05, abs=1e-3)


def test_a_lag_that_is_taken_away_leaves_one_tick() -> None:
    fast = drive(step_command(0.5), effect("valve_lag", extra_lag_s=-0.2), dead_s=0.0)
    assert fast[4, TELESCOPE] == pytest.approx(steady(0.5), rel=1e-2)


def test_a_dead_band_eats_the_command_around_zero_in_its_direction() -> None:
    band = effect("valve_dead_band", positive_ratio=0.2)
    assert steady(0.15, band) == pytest.approx(0.0, abs=1e-12)
    assert steady(0.6, band) == pytest.approx(steady(0.4), rel=1e-9)
    assert steady(-0.6, band) == steady(-0.6)


def test_gain_scales_the_steady_speed_of_its_direction() -> None:
    gain = effect("valve_gain", positive_ratio=-0.3, negative_ratio=0.2)
    assert steady(0.5, gain) == pytest.approx(0.7 * steady(0.5))
    assert steady(-0.5, gain) == pytest.approx(1.2 * steady(-0.5))


def test_hysteresis_leaves_the_spool_behind_by_its_half_width() -> None:
    play = effect("valve_hysteresis", half_width_ratio=0.1)
    up = np.concatenate([step_command(0.6, ticks=200), step_command(0.45, ticks=200)])
    velocity = drive(up, play)[:, TELESCOPE]
    assert velocity[199] == pytest.approx(steady(0.5), rel=1e-6)
    # On the way back the spool stays until the command has moved by twice the half width.
    assert velocity[399] == pytest.approx(steady(0.5), rel=1e-6)
    back = np.concatenate([step_command(0.6, ticks=200), step_command(0.2, ticks=200)])
    assert drive(back, play)[-1, TELESCOPE] == pytest.approx(steady(0.3), rel=1e-6)


def test_the_speed_limit_is_a_share_of_the_rated_speed() -> None:
    cap = effect("speed_limit", reduction_ratio=0.4)
    rated = SPEC.limits.speed_positive_rad_m_per_s[TELESCOPE]
    assert steady(1.0, cap) == pytest.approx(0.6 * rated)
    assert steady(0.3, cap) == steady(0.3)
    low = SPEC.limits.speed_negative_rad_m_per_s[TELESCOPE]
    assert steady(-1.0, cap) == pytest.approx(-0.6 * low)


def test_load_slows_the_motion_against_gravity_and_speeds_the_other() -> None:
    loss = effect("load_dependent_speed", "boom", loss_ratio=0.4)
    load = gravity_load_ratio(SPEC, MIDDLE)[0, BOOM]
    assert 0.5 < load <= 1.0
    for valve, sign in ((0.5, 1.0), (-0.5, -1.0)):
        expected = (1.0 - 0.4 * load * sign) * steady(valve, joint=BOOM)
        assert steady(valve, loss, joint=BOOM) == pytest.approx(expected)


def test_gravity_moments_are_mujocos() -> None:
    import mujoco

    from machine.kinematics import hanging_pitch_rad

    model, _ = twin_model()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    ratios: list[Array] = []
    for _ in range(5):
        pose = np.array([0.7, rng.uniform(0, 1.2), rng.uniform(-1, 1), rng.uniform(0, 1.7), 0, 0])
        pose[4] = hanging_pitch_rad(pose[:4])
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        ratios.append(data.qfrc_bias[1:4] / gravity_load_ratio(SPEC, pose[None, :4])[0, 1:])
        # About the slew axis: the weight of the arm times its distance.
        arm = model.body("boom").id
        foot = data.subtree_com[arm]
        tip = tipping_ratio(SPEC, pose[None, :4])[0]
        assert tip[0] / tip[1] == pytest.approx(-foot[1] / foot[0], rel=1e-9)
        ratios[-1] = np.append(ratios[-1], model.body_subtreemass[arm] * foot[0] / tip[1])
    np.testing.assert_allclose(np.stack(ratios), np.broadcast_to(ratios[0], (5, 4)), rtol=1e-9)
    assert (ratios[0] > 0.0).all()


def test_backlash_is_lost_at_each_reversal() -> None:
    gap = effect("backlash", gap_rad_m=0.04)
    there = np.concatenate([step_command(0.5, ticks=200), step_command(-0.5, ticks=200)])
    back = np.concatenate([there, step_command(0.5, ticks=200), step_command(0.0, ticks=100)])
    loose = drive(back, gap)
    lost = 0.01 * (np.cumsum(drive(back), axis=0) - np.cumsum(loose, axis=0))
    # The telescope hangs: at rest its drive pulls, so outward motion starts with the whole gap.
    assert lost[190, TELESCOPE] == pytest.approx(0.04, abs=1e-6)
    # Back it comes with a lag less; a joint that starts anew from rest loses a little more than the gap.
    assert -0.01 < lost[390, TELESCOPE] < 0.0
    assert lost[-1, TELESCOPE] == pytest.approx(0.04, abs=2e-3)
    # In the gap the joint stands where it came to rest, for as long as the drive alone takes.
    crossing = np.flatnonzero(loose[200:400, TELESCOPE] == 0.0)
    assert crossing.size == pytest.approx(0.04 / abs(steady(-0.5)) / 0.01, abs=1.5)
    assert (np.diff(crossing) == 1).all()


def test_the_slew_s_play_begins_where_the_measured_slew_says() -> None:
    """Nothing loads the slew: whether all of its play or none comes first, only the measurement knows."""
    valve = np.zeros((300, 4))
    valve[:, 0] = 0.4
    gap, free = effect("backlash", joint="slew", gap_rad_m=0.05), drive(valve)[:, 0]
    way = 0.01 * np.cumsum(free)

    def lost(moves_at: int) -> float:
        seen = np.where(np.arange(300)[:, None] < moves_at, 0.0, 0.3) * np.ones(4)
        return float(way[-1] - 0.01 * drive(valve, gap, seen=seen)[:, 0].sum())

    assert way[-1] - 0.01 * drive(valve, gap)[:, 0].sum() == pytest.approx(0.025, abs=5e-3)
    assert lost(0) == pytest.approx(0.0, abs=5e-3)
    assert lost(300) == pytest.approx(0.05, abs=5e-3), "never more than the play"
    # The drive alone is faster than the joint, which has to gather speed.
    assert lost(20) == pytest.approx(0.02, abs=5e-3)


def test_a_vanishing_gap_loses_in_proportion() -> None:
    lost = [
        0.01
        * (drive(step_command(0.5)) - drive(step_command(0.5), effect("backlash", gap_rad_m=g)))
        for g in (1e-5, 1e-3)
    ]
    for gap, way in zip((1e-5, 1e-3), lost, strict=True):
        assert way.sum(axis=0)[TELESCOPE] == pytest.approx(gap, rel=1e-3)


def test_a_sticking_joint_waits_for_the_breakaway_speed() -> None:
    ticks = 300
    ramp = np.zeros((ticks, 4))
    ramp[:, TELESCOPE] = np.linspace(0.0, 0.6, ticks)
    stuck = drive(ramp, effect("stiction", breakaway_rad_m_per_s=0.1), dead_s=0.0)[:, TELESCOPE]
    free = drive(ramp, dead_s=0.0)[:, TELESCOPE]
    wanted = np.interp(
        ramp[:, TELESCOPE],
        CALIBRATION.tables[TELESCOPE].valve_ratio,
        CALIBRATION.tables[TELESCOPE].actuator_speed_rad_m_per_s,
    )
    # What pushes is as late as the motion without stiction.
    lag_ticks = 200.0 * PROFILE.damping_ratio[3] / PROFILE.natural_frequency_rad_per_s[3]
    first = int(np.flatnonzero(stuck)[0])
    assert first == pytest.approx(np.flatnonzero(wanted > 0.1)[0] + lag_ticks, abs=2.0)
    assert (stuck[first:] > 0.0).all()
    assert free[first - 20] > 0.03
    assert stuck[-1] == pytest.approx(free[-1], rel=0.02)
    # Loose, it comes up with its oil within a few hundredths of a second.
    late = first + round(500.0 * SLIP_S)
    np.testing.assert_allclose(stuck[late:], free[late:], rtol=0.01)
    assert stuck[first] < 0.5 * free[first]


def test_a_moving_joint_with_too_small_a_command_comes_to_rest() -> None:
    valve = np.concatenate([step_command(0.5, ticks=100), step_command(0.06, ticks=300)])
    assert drive(valve)[-1, TELESCOPE] > 0.005
    stuck = drive(valve, effect("stiction", breakaway_rad_m_per_s=0.05))
    assert stuck[99, TELESCOPE] > 0.15
    assert stuck[-1, TELESCOPE] > 0.0, "slow, but never slow enough to stop"
    closed = np.concatenate([step_command(0.5, ticks=100), step_command(0.0, ticks=300)])
    assert drive(closed, effect("stiction", breakaway_rad_m_per_s=0.05))[-1, TELESCOPE] == 0.0


def test_a_joint_that_sticks_comes_to_rest_when_the_measured_one_did() -> None:
    valve = np.concatenate([step_command(0.5, ticks=100), step_command(0.06, ticks=300)])
    sticks = effect("stiction", breakaway_rad_m_per_s=0.05)
    stood = np.full(valve.shape, 0.1)
    stood[250:260] = 0.0
    stuck = drive(valve, sticks, seen=stood)[:, TELESCOPE]
    assert stuck[249] > 0.005
    assert not stuck[250:].any(), "it stays until the valve asks for more"
    closed = np.concatenate([step_command(0.5, ticks=100), step_command(0.0, ticks=300)])
    never = drive(closed, sticks, seen=np.full(closed.shape, 0.1))
    np.testing.assert_allclose(never[100:], drive(closed)[100:], atol=1e-4)
    reversed_ = np.where(np.arange(400)[:, None] < 250, 0.1, -0.1) * np.ones(4)
    assert not drive(valve, sticks, seen=reversed_)[250:, TELESCOPE].any()
    np.testing.assert_array_equal(drive(valve, seen=stood), drive(valve))


def test_a_short_pump_scales_all_joints_alike_when_they_ask_for_more() -> None:
    valve = np.tile([0.9, 0.8, 0.0, 0.9], (400, 1))
    short = Effect(effect="pump_flow_sharing", parameters={"shortage_ratio": 0.3})
    free, shared = drive(valve)[-1], drive(valve, short)[-1]
    asked = np.abs(free * np.abs(actuator_ratio(SPEC, MIDDLE)[0])) @ drive_flows(SPEC).positive_m2
    assert asked > 1.2 * SPEC.hydraulics.pump_flow_m3_per_s
    # A healthy pump is short too, but that is in the profile.
    np.testing.assert_allclose(shared[[0, 1, 3]], 0.7 * free[[0, 1, 3]], rtol=1e-6)
    alone = step_command(0.5)
    np.testing.assert_array_equal(drive(alone, short), drive(alone))
