"""The twin against physics that can be written down: pendulum, lag, clock, ballistics, determinism."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from machine.ballistics import drag_per_m
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array
from machine.errors import PlantError, UsageError
from machine.kinematics import hanging_pitch_rad
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import SimulatedDriver, ValveCommand
from sim_twin.rigid_body.model import twin_model
from sim_twin.twin.profile import TwinProfile, exact_profile, nominal_profile
from sim_twin.twin.twin import Twin
from tests.cases import each

SPEC = load_spec()
NOMINAL = nominal_profile(SPEC)
EXACT = exact_profile(NOMINAL)


def make(count: int = 1, profile: TwinProfile = EXACT, **options: object) -> Twin:
    return Twin(count=count, profile=profile, calibration=nominal_calibration(SPEC), **options)


def run(twin: Twin, ticks: int, valve: Array | None = None, opens: bool = False) -> list[Array]:
    """Step with constant valves; the true joint states (N, 12) after every tick."""
    still = np.zeros((twin.count, 4)) if valve is None else valve
    states: list[Array] = []
    for _ in range(ticks):
        twin.write(ValveCommand(still, np.full(twin.count, opens)))
        twin.advance(twin.now_ns() + CONTROL_PERIOD_NS)
        states.append(
            np.concatenate([twin.joint_position_rad_m, twin.joint_velocity_rad_m_per_s], axis=-1)
        )
    return states


def without_friction(profile: TwinProfile) -> TwinProfile:
    return profile.model_copy(
        update={"viscous_friction_per_s": (0.0, 0.0), "coulomb_friction_rad_per_s2": (0.0, 0.0)}
    )


def pendulum(axis_offset_m: float, inertia_axis: int) -> tuple[float, float]:
    """Moment of inertia about the axis and the restoring moment a radian of the hanging gripper."""
    p, ball = SPEC.passive, SPEC.ball
    arm = p.gripper_com_m + axis_offset_m
    inertia = p.gripper_inertia_kg_m2[inertia_axis] + p.gripper_mass_kg * arm**2
    moment = p.gripper_mass_kg * arm
    if axis_offset_m > 0.0:
        inertia += p.hanger_inertia_kg_m2[1] + p.hanger_mass_kg * p.hanger_com_m**2
        moment += p.hanger_mass_kg * p.hanger_com_m
    grip = SPEC.geometry.roll_to_grip_centre_m + axis_offset_m
    inertia += ball.mass_kg * grip**2 + 0.006
    moment += ball.mass_kg * grip
    return inertia, 9.81 * moment


def period_s(angle: Array) -> float:
    """Period from interpolated zero crossings of an oscillation sampled at 100 Hz."""
    up = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))
    times = (up - angle[up] / (angle[up + 1] - angle[up])) * 0.01
    return float(np.diff(times).mean())


@each(("joint", "offset_m", "axis"), [(4, 0.15, 1), (5, 0.0, 0)])
def test_free_swing_has_the_period_of_the_physical_pendulum(
    joint: int, offset_m: float, axis: int
) -> None:
    twin = make(profile=without_friction(EXACT))
    pose = safe_pose()[None].copy()
    pose[0, joint] += 0.05
    twin.reset(pose, 0)
    swing = np.stack(run(twin, 1500))[:, 0, joint] - safe_pose()[joint]
    inertia, stiffness = pendulum(offset_m, axis)
    expected = 2.0 * math.pi * math.sqrt(inertia / stiffness) * (1.0 + 0.05**2 / 16.0)
    assert period_s(swing) == pytest.approx(expected, rel=1e-3)
    assert np.abs(swing[-200:]).max() == pytest.approx(0.05, rel=0.02), "energy is kept"


def test_coulomb_friction_takes_the_same_angle_every_half_swing() -> None:
    profile = EXACT.model_copy(update={"viscous_friction_per_s": (0.0, 0.0)})
    twin = make(profile=profile)
    pose = safe_pose()[None].copy()
    pose[0, 4] += 0.4
    twin.reset(pose, 0)
    swing = np.stack(run(twin, 1400))[:, 0, 4] - safe_pose()[4]
    inner = swing[1:-1]
    peaks = np.abs(
        inner[(np.abs(inner) > np.abs(swing[:-2])) & (np.abs(inner) > np.abs(swing[2:]))]
    )
    _, stiffness = pendulum(0.15, 1)
    # Friction moment of 0.1 rad/s2 on the unloaded gripper's inertia about the pin (275 kg m2).
    lost = 2.0 * 27.5 / stiffness
    assert peaks.size >= 8
    np.testing.assert_allclose(-np.diff(peaks[1:8]), lost, rtol=0.08)


def test_a_step_of_the_valve_gives_the_second_order_response_after_the_dead_time() -> None:
    profile = EXACT.model_copy(update={"dead_time_s": (0.15, 0.08, 0.08, 0.087)})
    twin = make(profile=profile)
    twin.reset(safe_pose()[None], 0)
    valve = np.array([[0.0, 0.0, 0.0, 0.6]])
    speed = np.stack(run(twin, 60, valve))[:, 0, 9]
    steady = np.interp(
        0.6,
        *(
            nominal_calibration(SPEC).tables[3].valve_ratio,
            nominal_calibration(SPEC).tables[3].actuator_speed_rad_m_per_s,
        ),
    )
    w = profile.natural_frequency_rad_per_s[3]
    t = np.maximum(0.01 * np.arange(1, 61) - 0.087, 0.0)
    expected = steady * (1.0 - (1.0 + w * t) * np.exp(-w * t))
    np.testing.assert_allclose(speed, expected, atol=4e-3 * steady)
    assert abs(speed[7]) < 1e-6
    assert speed[8] > 1e-4


def test_boom_speed_follows_its_cylinders_moment_arm() -> None:
    from machine.calibration import actuator_ratio

    twin = make()
    twin.reset(safe_pose()[None], 0)
    states = np.stack(run(twin, 200, np.array([[0.0, -0.5, 0.0, 0.0]])))[:, 0]
    ratio = actuator_ratio(SPEC, states[:, :4])[:, 1]
    cylinder_speed = states[60:, 7] * ratio[60:]
    assert np.ptp(ratio[60:]) > 0.02
    assert np.ptp(cylinder_speed) < 0.02 * np.abs(cylinder_speed).mean()


def test_drives_follow_their_reference_whatever_the_load_does() -> None:
    profile = EXACT.model_copy(update={"natural_frequency_rad_per_s": (50.0,) * 4})
    twin = make(profile=profile)
    twin.reset(safe_pose()[None], 0)
    speed = np.stack(run(twin, 120, np.array([[0.5, 0.0, 0.0, 0.0]])))[:, 0, 6]
    assert np.ptp(speed[60:]) < 1e-6


def test_an_end_stop_holds_the_joint_and_lets_it_go_again() -> None:
    twin = make()
    twin.reset(safe_pose()[None], 0)
    high = SPEC.limits.position_max_rad_m[3]
    states = np.stack(run(twin, 500, np.array([[0.0, 0.0, 0.0, 1.0]])))[:, 0]
    assert states[:, 3].max() == pytest.approx(high, abs=1e-7)
    assert states[-1, 9] == pytest.approx(0.0, abs=1e-6)
    back = np.stack(run(twin, 100, np.array([[0.0, 0.0, 0.0, -1.0]])))[:, 0]
    assert back[-1, 3] < high - 0.1


def test_the_load_leaves_after_the_profiles_delay() -> None:
    twin = make()
    twin.reset(safe_pose()[None], 0)
    run(twin, 13)
    commanded = twin.now_ns()
    run(twin, 40, opens=True)
    assert twin.payload.release_t_ns[0] - commanded == 258_000_000
    assert not twin.read().payload_held[0]


def test_release_jitter_has_the_profiles_spread() -> None:
    twin = make(count=400, profile=NOMINAL)
    twin.reset(np.tile(safe_pose(), (400, 1)), 5)
    commanded = twin.now_ns()
    run(twin, 45, opens=True)
    delay = (twin.payload.release_t_ns - commanded) * 1e-9
    assert delay.mean() == pytest.approx(0.258, abs=0.003)
    assert delay.std() == pytest.approx(0.015, rel=0.15)


def test_taking_the_command_back_in_time_keeps_the_load() -> None:
    twin = make()
    twin.reset(safe_pose()[None], 0)
    run(twin, 20, opens=True)
    run(twin, 60, opens=False)
    assert twin.read().payload_held[0]
    run(twin, 30, opens=True)
    assert not twin.read().payload_held[0]


def swung_release(surface_m: float = 0.0) -> Twin:
    twin = make()
    twin.set_surface_height(np.array([surface_m]))
    pose = safe_pose()[None].copy()
    pose[0, 4] -= 0.7
    pose[0, 5] += 0.2
    twin.reset(pose, 0)
    run(twin, 160, np.array([[0.4, 0.0, 0.0, 0.0]]), opens=True)
    return twin


@each("surface_m", [0.0, 0.8])
def test_landing_agrees_with_an_independent_integration(surface_m: float) -> None:
    twin = swung_release(surface_m)
    load = twin.payload
    k = drag_per_m(SPEC.ball)

    def flight(_: float, state: Array) -> Array:
        velocity = state[3:]
        return np.concatenate(
            [velocity, [0.0, 0.0, -9.81] - k * np.linalg.norm(velocity) * velocity]
        )

    def ground(_: float, state: Array) -> float:
        return float(state[2] - surface_m - SPEC.ball.radius_m)

    ground.terminal = True
    start = np.concatenate([load.release_position_m[0], load.release_velocity_m_per_s[0]])
    answer = solve_ivp(flight, (0.0, 5.0), start, events=ground, rtol=1e-9, atol=1e-9)
    sample = twin.read()
    np.testing.assert_allclose(sample.impact_position_m[0, :2], answer.y[:2, -1], atol=1e-3)
    assert sample.impact_position_m[0, 2] == pytest.approx(surface_m, abs=1e-6)
    flight_s = (sample.impact_t_mono_ns[0] - load.release_t_ns[0]) * 1e-9
    assert flight_s == pytest.approx(answer.t[-1], abs=1e-4)


def test_the_load_leaves_from_mujocos_grip_centre_at_its_velocity() -> None:
    import mujoco

    from sim_twin.rigid_body.model import twin_model

    twin = make(profile=EXACT.model_copy(update={"release_delay_s": 0.25}))
    pose = safe_pose()[None].copy()
    pose[0, 4] -= 0.7
    pose[0, 5] += 0.2
    twin.reset(pose, 0)
    states = run(twin, 25, np.array([[0.4, 0.1, -0.2, 0.3]]), opens=True)
    model, _ = twin_model()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = states[-1][0, :6], states[-1][0, 6:]
    mujoco.mj_forward(model, data)
    site = model.site("grip_centre").id
    np.testing.assert_allclose(twin.payload.release_position_m[0], data.site_xpos[site], atol=1e-9)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 0)
    np.testing.assert_allclose(twin.payload.release_velocity_m_per_s[0], velocity[3:], atol=1e-9)


def test_the_tracked_ball_flies_to_the_surveyed_impact() -> None:
    twin = make()
    pose = safe_pose()[None].copy()
    pose[0, 4] -= 0.7
    twin.reset(pose, 0)
    path: list[Array] = []
    for _ in range(200):
        run(twin, 1, opens=True)
        sample = twin.read()
        if sample.ball_t_mono_ns[0]:
            assert sample.ball_t_mono_ns[0] == sample.t_mono_ns
            path.append(sample.ball_position_m[0])
        if sample.impact_t_mono_ns[0]:
            break
    assert sample.impact_t_mono_ns[0] <= sample.t_mono_ns
    assert np.isnan(sample.ball_position_m).all()
    last_step = path[-1] - path[-2]
    overshoot = path[-1] + last_step - sample.impact_position_m[0]
    assert len(path) > 30
    assert overshoot[2] < SPEC.ball.radius_m
    assert np.linalg.norm(overshoot[:2]) < np.linalg.norm(last_step[:2]) + 1e-3


def test_imu_of_a_hanging_gripper_shows_gravity_only() -> None:
    twin = make()
    pose = safe_pose(0.7)[None].copy()
    twin.reset(pose, 0)
    sample = twin.read()
    np.testing.assert_allclose(sample.imu_accel_m_per_s2[0], [0.0, 0.0, 9.81], atol=1e-3)
    np.testing.assert_allclose(sample.imu_gyro_rad_per_s[0], 0.0, atol=1e-9)


def test_imu_of_a_driven_gripper_is_consistent_with_its_motion() -> None:
    """Specific force = R^T (change of the IMU site's velocity over the tick - gravity)."""
    import mujoco

    from sim_twin.rigid_body.model import twin_model

    twin = make()
    pose = safe_pose()[None].copy()
    pose[0, 4] += 0.3
    twin.reset(pose, 0)
    states = run(twin, 60, np.array([[0.8, 0.5, -0.4, 0.6]]))
    sample = twin.read()
    model, _ = twin_model()
    data = mujoco.MjData(model)
    site = model.site("imu").id
    velocity, rotation = [], []
    for state in states[-2:]:
        data.qpos[:], data.qvel[:] = state[0, :6], state[0, 6:]
        mujoco.mj_forward(model, data)
        both = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, both, 0)
        velocity.append(both)
        rotation.append(data.site_xmat[site].reshape(3, 3).copy())
    acceleration = (velocity[1][3:] - velocity[0][3:]) / 0.01
    force = rotation[0].T @ (acceleration - np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose(sample.imu_accel_m_per_s2[0], force, atol=0.05)
    np.testing.assert_allclose(
        sample.imu_gyro_rad_per_s[0], rotation[0].T @ velocity[0][:3], atol=1e-6
    )
    assert sample.imu_t_mono_ns[0] == sample.t_mono_ns - CONTROL_PERIOD_NS


def busy(twin: Twin, seed: int) -> tuple[Array, Array]:
    """Sensor values and impacts of a motion that uses everything random."""
    pose = np.tile(safe_pose(), (twin.count, 1))
    pose[:, 4] -= 0.6
    twin.reset(pose, seed)
    rows: list[Array] = []
    for tick in range(170):
        valve = np.tile(0.5 * np.sin(0.05 * tick + np.arange(4.0)), (twin.count, 1))
        twin.write(ValveCommand(valve, np.full(twin.count, tick > 20)))
        twin.advance(twin.now_ns() + CONTROL_PERIOD_NS)
        s = twin.read()
        rows.append(
            np.concatenate(
                [
                    s.joint_position_rad_m,
                    s.joint_velocity_rad_m_per_s,
                    s.imu_gyro_rad_per_s,
                    s.imu_accel_m_per_s2,
                ],
                axis=-1,
            )
        )
    return np.stack(rows), twin.read().impact_position_m


def test_same_seed_same_throw_another_seed_another_one() -> None:
    profile = NOMINAL.model_copy(
        update={"noise": NOMINAL.noise.model_copy(update={"survey_sd_m": 0.02})}
    )
    twin = make(count=3, profile=profile)
    first, second, other = busy(twin, 7), busy(make(count=3, profile=profile), 7), busy(twin, 8)
    np.testing.assert_array_equal(first[1], second[1])
    assert np.isfinite(first[1]).all()
    assert np.abs(first[1] - other[1])[:, :2].max() > 1e-3
    assert np.abs(first[0] - other[0]).max() > 1e-3
    # Nor does a throw hang on those that the same twin has made before.
    again = busy(twin, 7)
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])


def test_noise_follows_the_clock_so_that_two_fresh_twins_agree_tick_by_tick() -> None:
    np.testing.assert_array_equal(
        busy(make(profile=NOMINAL), 7)[0], busy(make(profile=NOMINAL), 7)[0]
    )


@each("count", [2, 40])
def test_one_machine_equals_the_first_of_many(count: int) -> None:
    """Exactly: machines of a batch do not see each other, and neither do their random numbers."""
    alone, many = (
        busy(make(count=1, profile=NOMINAL), 3),
        busy(make(count=count, profile=NOMINAL), 3),
    )
    np.testing.assert_array_equal(alone[0][:, 0], many[0][:, 0])
    np.testing.assert_array_equal(alone[1][0], many[1][0])
    assert np.abs(many[1][0] - many[1][1])[:2].max() > 1e-4, "machines differ by their spread"


def test_sensor_noise_has_the_profiles_size() -> None:
    twin = make(count=200, profile=NOMINAL)
    twin.reset(np.tile(safe_pose(), (200, 1)), 0)
    position, accel = [], []
    for _ in range(30):
        run(twin, 1)
        position.append(twin.read().joint_position_rad_m - twin.joint_position_rad_m[:, :4])
        accel.append(twin.read().imu_accel_m_per_s2[:, 2] - 9.81)
    assert np.std(position) == pytest.approx(0.001, rel=0.05)
    assert np.std(accel) == pytest.approx(4.2e-3, rel=0.05)


def test_touching_the_ground_is_noticed_and_hanging_free_is_not() -> None:
    low = safe_pose()
    low[1], low[2], low[3] = 0.0, 0.0, 1.5
    low[4] = hanging_pitch_rad(low[:4])
    twin = make(count=2)
    twin.reset(np.stack([safe_pose(), low]), 0)
    run(twin, 5)
    np.testing.assert_array_equal(twin.collided(), [False, True])
    twin.reset(np.tile(safe_pose(), (2, 1)), 0)
    np.testing.assert_array_equal(twin.collided(), [False, False])


def test_frozen_machines_stand_still_until_the_reset() -> None:
    twin = make(count=2)
    twin.reset(np.tile(safe_pose(), (2, 1)), 0)
    twin.freeze(np.array([False, True]))
    moved = run(twin, 50, np.full((2, 4), 0.5))[-1][:, :4]
    assert moved[0, 0] > 0.01
    np.testing.assert_array_equal(moved[1], safe_pose()[:4])
    twin.reset(np.tile(safe_pose(), (2, 1)), 0)
    assert run(twin, 50, np.full((2, 4), 0.5))[-1][1, 0] > 0.01


def test_a_new_load_forgets_the_last_impact() -> None:
    twin = swung_release()
    assert twin.read().impact_t_mono_ns[0] > 0
    twin.load()
    sample = twin.read()
    assert sample.payload_held[0]
    assert sample.impact_t_mono_ns[0] == 0
    assert np.isnan(sample.impact_position_m).all()
    assert np.isnan(twin.true_impact_m()).all()


def test_the_clock_moves_in_whole_ticks_and_survives_a_reset() -> None:
    twin = make()
    start = twin.now_ns()
    twin.advance(start + 25_000_000)
    assert twin.now_ns() == start + 20_000_000
    twin.reset(safe_pose()[None], 0)
    assert twin.now_ns() == start + 20_000_000


@each("valve", [np.full((1, 4), np.nan), np.full((1, 4), 1.5), np.zeros((2, 4)), np.zeros((1, 3))])
def test_impossible_valve_commands_are_refused(valve: Array) -> None:
    twin = make()
    with pytest.raises(PlantError, match="valve commands must be"):
        twin.write(ValveCommand(valve, np.zeros(1, dtype=np.bool_)))


def test_reset_refuses_poses_that_are_no_poses() -> None:
    twin = make()
    with pytest.raises(PlantError, match=r"finite poses of shape \(1, 6\)"):
        twin.reset(np.full((1, 6), np.nan), 0)


def test_the_plant_factory_gives_the_nominal_twin_only() -> None:
    assert isinstance(Twin.for_plant(count=2, unit_seed=0), SimulatedDriver)
    with pytest.raises(UsageError, match="no unit 3"):
        Twin.for_plant(count=2, unit_seed=3)
    with pytest.raises(UsageError, match="at least 1 machine"):
        Twin.for_plant(count=0, unit_seed=0)


def test_what_mujoco_warns_of_is_logged_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    model = twin_model()[0]
    data = mujoco.MjData(model)
    data.qvel[0] = np.nan
    mujoco.mj_step(model, data)
    assert "unstable" in caplog.text
    assert list(tmp_path.iterdir()) == []
