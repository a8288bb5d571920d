"""Effects of body, base, load and sensors against physics that can be written down."""

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from machine.ballistics import drag_per_m
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array
from machine.kinematics import hanging_pitch_rad, rotate_z
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import ValveCommand
from sim_twin.effects.body_effects import loaded_mass_kg
from sim_twin.effects.effect import Effect
from sim_twin.replay.replay import fly
from sim_twin.rigid_body.arm_load import largest_tipping_moment, tipping_ratio
from sim_twin.rigid_body.grip_point import grip_point, gripper_axes, gripper_rate
from sim_twin.rigid_body.model import twin_model
from sim_twin.twin.chassis_sway import BASE_INERTIA_KG_M2, DAMPING_RATIO
from sim_twin.twin.profile import TwinProfile, exact_profile, nominal_profile
from sim_twin.twin.twin import Twin
from tests.cases import each

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
PROFILE = exact_profile(nominal_profile(SPEC))
FREE = PROFILE.model_copy(
    update={"viscous_friction_per_s": (0.0, 0.0), "coulomb_friction_rad_per_s2": (0.0, 0.0)}
)
G = 9.81


def effect(name: str, joint: str | None = None, **parameters: float) -> Effect:
    return Effect(effect=name, joint=joint, parameters=parameters)


def make(*effects: Effect, profile: TwinProfile = PROFILE) -> Twin:
    return Twin(count=1, profile=profile, calibration=CALIBRATION, effects=[effects])


def swung(joint: int, angle: float) -> Array:
    pose = safe_pose()[None].copy()
    pose[0, joint] += angle
    return pose


def run(twin: Twin, ticks: int, opens: bool = False, valve: Array | None = None) -> Array:
    """True joint states (T, 12) after every tick."""
    still = np.zeros((1, 4)) if valve is None else valve
    states: list[Array] = []
    for _ in range(ticks):
        twin.write(ValveCommand(still, np.array([opens])))
        twin.advance(twin.now_ns() + CONTROL_PERIOD_NS)
        states.append(
            np.concatenate([twin.joint_position_rad_m, twin.joint_velocity_rad_m_per_s], 1)
        )
    return np.concatenate(states)


def swing_period_s(twin: Twin, joint: int, angle: float = 0.05) -> float:
    twin.reset(swung(joint, angle), 0)
    swing = run(twin, 1500)[:, joint] - safe_pose()[joint]
    up = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    times = (up - swing[up] / (swing[up + 1] - swing[up])) * 0.01
    return float(np.diff(times).mean())


def pendulum(
    joint: int, longer_m: float = 0.0, inertia_ratio: float = 1.0, load_kg: float = 0.0
) -> tuple[float, float]:
    """Moment of inertia about a free joint, and the restoring moment a radian."""
    model, _ = twin_model()
    axis = SPEC.geometry.pitch_to_roll_m if joint == 4 else 0.0
    which = 1 if joint == 4 else 0
    gripper, load = model.body("gripper"), model.body("payload")
    arm = axis - float(gripper.ipos[2]) + longer_m
    grip = axis + SPEC.geometry.roll_to_grip_centre_m + longer_m
    mass, ball = float(gripper.mass[0]), float(load.mass[0]) + load_kg
    inertia = float(gripper.inertia[which]) * inertia_ratio + mass * arm**2 + ball * grip**2
    inertia += float(load.inertia[which]) * ball / float(load.mass[0])
    moment = mass * arm + ball * grip
    if joint == 4:
        hanger = model.body("hanger")
        com = -float(hanger.ipos[2])
        inertia += float(hanger.inertia[1]) + float(hanger.mass[0]) * com**2
        moment += float(hanger.mass[0]) * com
    return inertia, G * moment


@each("joint", [4, 5])
@each(
    ("change", "options"),
    [
        (effect("gripper_length", extra_length_m=0.25), {"longer_m": 0.25}),
        (effect("gripper_inertia", extra_inertia_ratio=0.7), {"inertia_ratio": 1.7}),
        (effect("payload_mass", extra_mass_kg=5.0), {"load_kg": 5.0}),
    ],
)
def test_masses_and_lengths_change_the_period(
    joint: int, change: Effect, options: dict[str, float]
) -> None:
    inertia, stiffness = pendulum(joint, **options)
    expected = 2.0 * math.pi * math.sqrt(inertia / stiffness) * (1.0 + 0.05**2 / 16.0)
    assert swing_period_s(make(change, profile=FREE), joint) == pytest.approx(expected, rel=3e-4)


def test_effects_together_never_make_a_mass_negative() -> None:
    nominal = np.array([0.6, 0.6])
    found = loaded_mass_kg(nominal, np.array([-0.4, -0.9]))
    np.testing.assert_allclose(found, [0.2, 0.06])
    lost = effect("payload_mass", extra_mass_kg=-0.5), effect("payload_mass", extra_mass_kg=-0.4)
    twin = make(*lost, profile=FREE)
    twin.reset(swung(4, 0.3), 0)
    assert np.isfinite(run(twin, 50)).all()


def test_hoses_stiffen_the_pendulum_about_the_throws_start() -> None:
    hose = effect("hose_stiffness", stiffness_per_s2=2.0)
    twin = make(hose, profile=FREE)
    start = 0.3
    twin.reset(swung(4, start), 0)
    swing = run(twin, 1500)[:, 4] - safe_pose()[4]
    inertia, stiffness = pendulum(4)
    _, moment = twin_model()
    spring = 2.0 * float(moment[0])
    # It swings about the angle at which gravity and hoses balance.
    middle = spring * start / (stiffness + spring)
    assert 0.5 * (swing.min() + swing.max()) == pytest.approx(middle, abs=3e-3)
    fall = start - middle
    expected = 2.0 * math.pi * math.sqrt(inertia / (stiffness + spring)) * (1.0 + fall**2 / 16.0)
    centred = swing - middle
    up = np.flatnonzero((centred[:-1] < 0.0) & (centred[1:] >= 0.0))
    times = (up - centred[up] / (centred[up + 1] - centred[up])) * 0.01
    assert np.diff(times).mean() == pytest.approx(expected, rel=3e-3)


def test_added_friction_is_friction_of_the_profile() -> None:
    more = PROFILE.model_copy(
        update={
            "viscous_friction_per_s": tuple(0.2 + v for v in PROFILE.viscous_friction_per_s),
            "coulomb_friction_rad_per_s2": tuple(
                0.1 + c for c in PROFILE.coulomb_friction_rad_per_s2
            ),
        }
    )
    viscous = effect("passive_viscous_friction", extra_viscous_per_s=0.2)
    dry = effect("passive_coulomb_friction", extra_coulomb_rad_per_s2=0.1)
    by_effect, by_profile = make(viscous, dry), make(profile=more)
    for twin in (by_effect, by_profile):
        twin.reset(swung(4, 0.5), 0)
    np.testing.assert_allclose(run(by_effect, 300), run(by_profile, 300), atol=1e-12)


def test_friction_cannot_drive_and_the_strongest_does_not_chatter() -> None:
    less = make(effect("passive_viscous_friction", extra_viscous_per_s=-0.03), profile=FREE)
    less.reset(swung(4, 0.5), 0)
    free = make(profile=FREE)
    free.reset(swung(4, 0.5), 0)
    np.testing.assert_array_equal(run(less, 100), run(free, 100))
    stiff = make(effect("passive_coulomb_friction", extra_coulomb_rad_per_s2=0.6))
    stiff.reset(swung(4, 0.3), 0)
    rates = run(stiff, 1200)[-300:, 10]
    assert np.abs(rates).max() < 2e-3, "dry friction brings it to rest"
    assert np.abs(np.diff(np.sign(rates))).sum() <= 2.0


def test_points_of_the_gripper_are_mujocos() -> None:
    model, _ = twin_model()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:], data.qvel[:] = 0.5 * rng.standard_normal(6), rng.standard_normal(6)
    mujoco.mj_forward(model, data)
    q, v = data.qpos[None].copy(), data.qvel[None].copy()
    site = model.site("imu")
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site.id, velocity, 0)
    offset = (site.pos - model.site("grip_centre").pos)[None]
    state = grip_point(SPEC, q, v, offset)
    np.testing.assert_allclose(state.position_m[0], data.site("imu").xpos, atol=1e-12)
    np.testing.assert_allclose(state.velocity_m_per_s[0], velocity[3:], atol=1e-12)
    axes = data.body("gripper").xmat.reshape(3, 3)
    np.testing.assert_allclose(gripper_axes(q)[0], axes, atol=1e-12)
    np.testing.assert_allclose(gripper_rate(q, v)[0], velocity[:3], atol=1e-12)


@each("surface_m", [0.0, 0.6])
def test_flight_effects_agree_with_an_independent_integration(surface_m: float) -> None:
    position, velocity = np.array([[5.0, 1.0, 2.5]]), np.array([[6.0, 2.0, 4.0]])
    effects = [
        effect("air_drag", extra_drag_coefficient_ratio=0.3),
        effect("wind", x_m_per_s=-2.0, y_m_per_s=3.0),
        effect("release_spin", spin_rad_per_s=12.0),
        effect("payload_mass", extra_mass_kg=0.4),
    ]
    ball = SPEC.ball
    mass, area = ball.mass_kg + 0.4, math.pi * ball.radius_m**2
    air = ball.air_density_kg_per_m3 * area / (2.0 * mass)
    axis = np.cross(velocity[0], [0.0, 0.0, 1.0])
    axis /= np.linalg.norm(axis)
    wind = np.array([-2.0, 3.0, 0.0])

    def motion(_: float, state: Array) -> Array:
        through = state[3:] - wind
        speed = np.linalg.norm(through)
        lift = air / (2.32 + 0.4 * speed / (ball.radius_m * 12.0))
        drag = -air * (ball.drag_coefficient_ratio + 0.3) * speed * through
        pull = drag + lift * speed * np.cross(axis, through) + [0.0, 0.0, -G]
        return np.concatenate([state[3:], pull])

    def ground(_: float, state: Array) -> float:
        return float(state[2] - surface_m - ball.radius_m)

    ground.terminal, ground.direction = True, -1.0
    start = np.concatenate([position[0], velocity[0]])
    answer = solve_ivp(motion, (0.0, 5.0), start, events=ground, rtol=1e-10, atol=1e-10)
    flight = fly(position, velocity, PROFILE, [effects], surface_height_m=surface_m)
    np.testing.assert_allclose(flight.impact_m[0, :2], answer.y[:2, -1], atol=1e-3)
    assert flight.flight_s[0] == pytest.approx(answer.t[-1], abs=1e-4)
    assert drag_per_m(ball) * ball.mass_kg == pytest.approx(
        air * mass * ball.drag_coefficient_ratio
    )


def test_backspin_lifts_and_topspin_drops() -> None:
    position, velocity = np.tile([0.0, 0.0, 2.0], (3, 1)), np.tile([6.0, 3.0, 3.0], (3, 1))
    spins = [[effect("release_spin", spin_rad_per_s=s)] for s in (-20.0, 0.0, 20.0)]
    flight = fly(position, velocity, PROFILE, spins)
    assert (np.diff(flight.flight_s) > 0.02).all()


def released(*effects: Effect) -> Twin:
    twin = make(*effects)
    twin.reset(swung(4, -0.7), 0)
    run(twin, 60, opens=True, valve=np.array([[0.5, 0.0, 0.0, 0.0]]))
    run(twin, 120)
    return twin


def test_a_sticking_load_leaves_slower_from_the_same_place() -> None:
    plain, sticky = released(), released(effect("sticky_release", slowdown_ratio=0.25))
    for name, share in (("release_position_m", 1.0), ("release_velocity_m_per_s", 0.75)):
        np.testing.assert_allclose(
            getattr(sticky.payload, name), share * getattr(plain.payload, name), rtol=1e-12
        )


def test_further_jitter_widens_the_spread_and_keeps_the_mean() -> None:
    jitter = effect("release_jitter", extra_sd_s=0.02)
    profile = nominal_profile(SPEC).model_copy(update={"effects": (jitter,)})
    twin = Twin(count=600, profile=profile, calibration=CALIBRATION)
    twin.reset(np.tile(safe_pose(), (600, 1)), 1)
    begin = twin.now_ns()
    twin.write(ValveCommand(np.zeros((600, 4)), np.ones(600, dtype=np.bool_)))
    delay = (twin.payload.release_t_ns - begin) * 1e-9
    assert delay.mean() == pytest.approx(0.258, abs=0.004)
    assert delay.std() == pytest.approx(math.hypot(0.015, 0.02), rel=0.1)


def test_a_yawed_and_raised_base_moves_the_whole_throw() -> None:
    plain = released().payload
    moved = released(
        effect("base_yaw_drift", yaw_rad=0.1), effect("base_height", extra_height_m=0.3)
    ).payload
    turned = rotate_z(plain.release_position_m, np.array([0.1]))
    np.testing.assert_allclose(
        moved.release_position_m, turned + np.array([0.0, 0.0, 0.3]), atol=1e-12
    )
    turned = rotate_z(plain.release_velocity_m_per_s, np.array([0.1]))
    np.testing.assert_allclose(moved.release_velocity_m_per_s, turned, atol=1e-12)
    assert np.linalg.norm(moved.impact_m) != pytest.approx(np.linalg.norm(plain.impact_m), abs=0.02)


@each(
    "lean",
    [
        effect("base_tilt", roll_rad=0.08, pitch_rad=-0.06),
        effect("chassis_compliance", pitch_rad=0.06),
    ],
)
def test_a_gripper_hangs_plumb_from_a_leaning_machine(lean: Effect) -> None:
    twin = make(lean)
    twin.reset(safe_pose(0.6)[None], 0)
    off = twin.joint_position_rad_m[0, 4:] - safe_pose(0.6)[4:]
    assert np.abs(off).max() > 0.02, "against the machine it leans"
    np.testing.assert_allclose(run(twin, 300)[-1, 6:], 0.0, atol=2e-3)
    sample = twin.read()
    np.testing.assert_allclose(sample.imu_accel_m_per_s2[0], [0.0, 0.0, G], atol=0.01)


def test_positive_pitch_puts_the_front_down_and_positive_roll_the_left_up() -> None:
    pose = safe_pose()[None]
    for change, axis, sign in (
        (effect("base_tilt", pitch_rad=0.05), 2, -1.0),
        (effect("base_tilt", roll_rad=0.05), 1, 1.0),
    ):
        height: list[Array] = []
        for twin in (make(change), make()):
            twin.reset(pose, 0)
            run(twin, 40, opens=True)
            height.append(twin.payload.release_position_m[0])
        # The arm points along x, 5 m out: pitch lowers it; roll moves what is high to -y.
        moved = height[0] - height[1]
        assert (moved[2] if axis == 2 else -moved[1]) * sign > 0.05


def sprung_machine(size_rad: float) -> mujoco.MjModel:
    """The machine on a chassis with springs and dampers, its drives immovable by what it carries."""
    tree = mujoco.MjSpec.from_file("machine/m545.xml")
    chassis, upper = tree.body("chassis"), tree.body("upper")
    stiffness = G * largest_tipping_moment(SPEC) / size_rad
    for number, axis in enumerate(([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])):
        # Damping for the inertia of base and arm, the arm some 5 m out and 3 m up.
        inertia = BASE_INERTIA_KG_M2[number] + 2000.0 * (5.0**2 * number + 3.0**2)
        chassis.add_joint(
            name=f"lean_{number}",
            axis=axis,
            pos=[0.0, 0.0, -0.85],
            stiffness=stiffness,
            damping=2.0 * DAMPING_RATIO * math.sqrt(stiffness * inertia),
        )
    chassis.explicitinertial = True
    # The whole base about the ground; its weight is levelled out.
    chassis.mass, chassis.ipos = 1e-3, np.zeros(3)
    chassis.inertia = np.array([*BASE_INERTIA_KG_M2, 30_000.0])
    upper.mass, upper.inertia = 1e-3, np.full(3, 1e-3)
    tree.option.timestep = 0.001
    tree.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = tree.compile()
    model.jnt_limited[:] = 0
    model.dof_damping[2:], model.dof_frictionloss[:] = 0.0, 0.0
    model.dof_armature[2:6] = 1e12
    return model


def test_a_giving_chassis_is_the_chassis_on_springs() -> None:
    """Against a MuJoCo model whose base has joints: the gripper swings the same way, the IMU turns alike."""
    size, ticks = 0.04, 200
    valve = np.array([[0.35, 0.5, 0.0, 0.0]])
    pose = safe_pose(0.3)[None]
    soft, rigid = make(effect("chassis_compliance", pitch_rad=size)), make()
    for twin in (soft, rigid):
        twin.reset(pose, 0)
    began = soft.joint_position_rad_m
    path, stiff = run(soft, ticks, valve=valve), run(rigid, ticks, valve=valve)
    model = sprung_machine(size)
    data = mujoco.MjData(model)
    data.qpos[2:] = began[0]
    data.qpos[:2] = size * tipping_ratio(SPEC, began[:, :4])[0, :2]
    driven = np.concatenate([np.zeros((1, 4)), path[:, 6:10]])
    _, moment = twin_model()
    viscous = np.asarray(PROFILE.viscous_friction_per_s) * moment
    dry = np.asarray(PROFILE.coulomb_friction_rad_per_s2) * moment
    swings: list[Array] = []
    for tick in range(ticks):
        for _ in range(10):
            rate = data.qvel[6:].copy()
            data.qfrc_applied[2:6] = 1e12 * (driven[tick + 1] - driven[tick]) / 0.01
            data.qfrc_applied[6:] = -viscous * rate - dry * np.tanh(rate / 0.004)
            mujoco.mj_step(model, data)
        swings.append(data.qpos[6:].copy())
    given = np.abs(path[:, 4:6] - path[0, 4:6] - (stiff[:, 4:6] - stiff[0, 4:6])).max()
    left = np.abs(path[:, 4:6] - np.stack(swings)).max()
    assert given > 0.02
    assert left < 0.15 * given


def test_sensors_report_biased_late_and_turned_values() -> None:
    valve = np.array([[0.6, 0.3, 0.0, 0.0]])
    twin = make(
        effect("joint_sensor_bias", "slew", bias_rad_m=0.03),
        effect("joint_sensor_latency", "slew", extra_latency_s=0.025),
        effect("imu_latency", extra_latency_s=0.03),
        effect("imu_misalignment", yaw_rad=0.2),
    )
    plain = make()
    true_start = safe_pose()[None]
    reported = true_start.copy()
    reported[0, 0] += 0.03
    twin.reset(reported, 0)
    plain.reset(true_start, 0)
    seen: list[Array] = []
    gyro: list[Array] = []
    for _ in range(80):
        run(twin, 1, valve=valve)
        run(plain, 1, valve=valve)
        ours, theirs = twin.read(), plain.read()
        seen.append(
            np.array(
                [
                    [s.joint_position_rad_m[0, 0], s.joint_velocity_rad_m_per_s[0, 0]]
                    for s in (ours, theirs)
                ]
            )
        )
        gyro.append(np.stack([ours.imu_gyro_rad_per_s[0], theirs.imu_gyro_rad_per_s[0]]))
        assert ours.imu_t_mono_ns[0] == theirs.imu_t_mono_ns[0]
    joints, rates = np.stack(seen), np.stack(gyro)
    # Half way between two rows, on the parabola through them and the one before.
    late = 0.375 * joints[38:78, 1] + 0.75 * joints[37:77, 1] - 0.125 * joints[36:76, 1]
    np.testing.assert_allclose(joints[40:, 0] - [0.03, 0.0], late, atol=1e-9)
    turn = rotate_z(rates[37:77, 1], np.full(40, -0.2))
    np.testing.assert_allclose(rates[40:, 0], turn, atol=1e-9)


def test_a_biased_boom_hangs_plumb_at_another_true_angle() -> None:
    twin = make(effect("joint_sensor_bias", "boom", bias_rad_m=0.06))
    twin.reset(safe_pose()[None], 0)
    true = twin.joint_position_rad_m[0]
    assert true[1] == pytest.approx(safe_pose()[1] - 0.06)
    assert true[4] == pytest.approx(float(hanging_pitch_rad(true[None, :4])[0]))
    assert twin.read().joint_position_rad_m[0, 1] == pytest.approx(safe_pose()[1])
