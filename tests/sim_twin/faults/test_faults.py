"""Every effect of the virtual machine changes what it should by what its parameter says."""

from collections.abc import Callable

import numpy as np
import pytest

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_NS, Array, Mode
from machine.errors import PlantError
from machine.kinematics import pin_in_plane
from machine.spec import load_spec
from machine.starts import safe_pose, sample_starts
from runtime.driver import ValveCommand
from sim_twin.effects.schema import DRIFT
from sim_twin.faults.fault import Fault
from sim_twin.faults.fault_tables import FAULTS, TABLE_FAULTS, UNLISTED_FAULTS
from sim_twin.virtual_machine import Condition, VirtualMachine
from tests.cases import each

SPEC = load_spec()
TICK_S = CONTROL_PERIOD_NS * 1e-9
RNG = np.random.default_rng(5)


def machine(*effects: Fault, count: int = 1, places: Array | None = None) -> VirtualMachine:
    condition = Condition(effects=effects, place_ratio=places)
    return VirtualMachine(count=count, unit_seed=0, tracker=False, condition=condition)


def effect(name: str, joint: str | None = None, **parameters: float) -> Fault:
    return Fault(name, joint, parameters)


def drive(
    plant: VirtualMachine,
    command: Callable[[float], Array],
    seconds: float,
    pose: Array | None = None,
    opens_at_s: float = np.inf,
) -> tuple[Array, Array]:
    """True joint positions and velocities (ticks, 6) of the first copy."""
    start = safe_pose() if pose is None else pose
    plant.reset(np.tile(start, (plant.count, 1)), seed=3)
    positions, velocities = [], []
    for tick in range(round(seconds / TICK_S)):
        valve = np.tile(command(tick * TICK_S), (plant.count, 1))
        plant.write(ValveCommand(valve, np.full(plant.count, tick * TICK_S >= opens_at_s)))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        truth = plant.truth()
        positions.append(truth.joint_position_rad_m[0])
        velocities.append(truth.joint_velocity_rad_m_per_s[0])
    return np.stack(positions), np.stack(velocities)


def step(joint: str, size: float) -> Callable[[float], Array]:
    valve = size * (np.array(ACTIVE_JOINTS) == joint)
    return lambda _: valve


def steady(plant: VirtualMachine, joint: str, size: float, seconds: float = 1.2) -> float:
    _, velocity = drive(plant, step(joint, size), seconds)
    return float(velocity[-30:, ACTIVE_JOINTS.index(joint)].mean())


def onset_s(velocity: Array, share: float = 0.5) -> float:
    """When a joint's speed first passes a share of its last."""
    return float(np.argmax(np.abs(velocity) > share * abs(velocity[-1]))) * TICK_S


def test_no_effect_is_the_machine_as_built() -> None:
    plain = VirtualMachine(count=2, unit_seed=0, tracker=False)
    empty = machine(count=2)
    idle = machine(effect("valve_gain", "boom", positive_ratio=0.0), count=2)
    runs = [drive(m, step("boom", 0.5), 0.5)[0] for m in (plain, empty, idle)]
    assert np.array_equal(runs[0], runs[1])
    assert np.allclose(runs[0], runs[2], atol=1e-12)


def test_dead_time_delays_and_keeps_the_shape() -> None:
    _, plain = drive(machine(), step("boom", 0.5), 1.0)
    late = machine(effect("valve_dead_time", "boom", extra_dead_time_s=0.25))
    _, velocity = drive(late, step("boom", 0.5), 1.0)
    assert np.allclose(velocity[25:, 1], plain[:-25, 1], atol=0.02)


def test_lag_adds_its_time_constant_to_the_mean_delay() -> None:
    def mean_delay(plant: VirtualMachine) -> float:
        _, velocity = drive(plant, step("telescope", 0.4), 2.0)
        return float(np.sum(1.0 - velocity[:, 3] / velocity[-1, 3])) * TICK_S

    extra = mean_delay(machine(effect("valve_lag", "telescope", extra_lag_s=0.1)))
    assert extra - mean_delay(machine()) == pytest.approx(0.1, abs=0.02)


def test_dead_band_eats_the_command_one_way_only() -> None:
    band = effect("valve_dead_band", "telescope", positive_ratio=0.2)
    assert steady(machine(band), "telescope", 0.5) == pytest.approx(
        steady(machine(), "telescope", 0.3), rel=0.02
    )
    assert steady(machine(band), "telescope", -0.3) == pytest.approx(
        steady(machine(), "telescope", -0.3), rel=1e-6
    )


@each(("joint", "size"), [("slew", 0.5), ("boom", -0.4), ("telescope", 0.4)])
def test_gain_scales_the_steady_speed(joint: str, size: float) -> None:
    side = "positive_ratio" if size > 0.0 else "negative_ratio"
    seconds = 3.0 if joint == "slew" else 1.0
    gained = Fault("valve_gain", joint, {side: 0.3})
    more = steady(machine(gained), joint, size, seconds)
    assert more / steady(machine(), joint, size, seconds) == pytest.approx(1.3, abs=0.05)


@each(("joint", "size"), [("boom", -1.0), ("boom", 1.0), ("telescope", 1.0)])
def test_speed_limit_caps_the_joint_speed(joint: str, size: float) -> None:
    speed = abs(
        steady(machine(effect("speed_limit", joint, reduction_ratio=0.5)), joint, size, 0.8)
    )
    limits = SPEC.limits
    rated = limits.speed_positive_rad_m_per_s if size > 0.0 else limits.speed_negative_rad_m_per_s
    assert speed == pytest.approx(0.5 * rated[ACTIVE_JOINTS.index(joint)], rel=0.06)


def test_load_slows_lifting_and_speeds_lowering() -> None:
    loaded = effect("load_dependent_speed", "boom", loss_ratio=0.4)
    up = steady(machine(loaded), "boom", 0.5, 0.8) / steady(machine(), "boom", 0.5, 0.8)
    down = steady(machine(loaded), "boom", -0.5, 0.8) / steady(machine(), "boom", -0.5, 0.8)
    assert 0.6 <= up < 0.9
    assert 1.1 < down <= 1.4
    assert up + down == pytest.approx(2.0, abs=0.08)


def test_hysteresis_costs_its_width_at_a_reversal() -> None:
    wide = machine(effect("valve_hysteresis", "telescope", half_width_ratio=0.1))
    assert steady(wide, "telescope", 0.5) == pytest.approx(
        steady(machine(), "telescope", 0.4), rel=0.02
    )


def test_stiction_holds_until_the_speed_would_be_large_enough() -> None:
    stuck = effect("stiction", "telescope", breakaway_rad_m_per_s=0.1)
    position, _ = drive(machine(stuck), step("telescope", 0.2), 1.0)
    assert np.ptp(position[:, 3]) < 1e-3
    position, _ = drive(machine(stuck), step("telescope", 0.6), 1.0)
    assert position[-1, 3] - position[0, 3] > 0.1


def test_backlash_loses_its_gap_at_a_reversal() -> None:
    def there_and_back(t_s: float) -> Array:
        return np.array([0.0, 0.0, 0.0, 0.4 if t_s < 1.0 else -0.4])

    plain, loose = (
        drive(machine(*e), there_and_back, 2.0)[0][:, 3]
        for e in ((), (effect("backlash", "telescope", gap_rad_m=0.05),))
    )
    # The telescope hangs on the other side of its gap: it is crossed on the way out and back again.
    assert plain.max() - loose.max() == pytest.approx(0.05, abs=0.012)
    assert loose[-1] == pytest.approx(plain[-1], abs=0.012)
    turned = 110
    assert np.ptp(loose[turned : turned + 12]) < 0.2 * np.ptp(plain[turned : turned + 12])


def test_a_weaker_pump_slows_only_what_needs_it_all() -> None:
    weak = effect("pump_flow_sharing", shortage_ratio=0.4)
    both = np.array([0.0, 1.0, 0.0, 1.0])
    _, plain = drive(machine(), lambda _: both, 0.6)
    _, slow = drive(machine(weak), lambda _: both, 0.6)
    assert slow[-20:, 1].mean() / plain[-20:, 1].mean() < 0.75
    assert steady(machine(weak), "telescope", 0.3) == pytest.approx(
        steady(machine(), "telescope", 0.3), rel=0.03
    )


def swing(*effects: Fault) -> Array:
    """Pitch about plumb of a gripper let go 0.3 rad aside, arm at rest, (ticks,)."""
    pose = safe_pose()
    pose[4] += 0.3
    return drive(machine(*effects), step("boom", 0.0), 4.0, pose)[0][:, 4] - safe_pose()[4]


def period_s(angle: Array) -> float:
    down = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    return float(np.mean(np.diff(down))) * TICK_S


def test_swing_effects_change_damping_and_period() -> None:
    plain = swing()
    late = slice(-150, None)
    assert np.abs(
        swing(effect("passive_viscous_friction", extra_viscous_per_s=0.4))[late]
    ).max() < (0.7 * np.abs(plain[late]).max())
    sticky = swing(effect("passive_coulomb_friction", extra_coulomb_rad_per_s2=0.4))
    assert np.abs(sticky[late]).max() < 0.9 * np.abs(plain[late]).max()
    longer = swing(effect("gripper_length", extra_length_m=0.2))
    assert period_s(longer) > 1.03 * period_s(plain)
    assert period_s(swing(effect("gripper_inertia", extra_inertia_ratio=0.5))) > period_s(plain)


def test_a_hose_pulls_towards_the_start_angle() -> None:
    # At the start the hose is at rest: it pulls only once the gripper has swung.
    angle = swing(effect("hose_stiffness", stiffness_per_s2=3.0))
    assert angle[-200:].mean() > swing()[-200:].mean() + 0.03


def throw(*effects: Fault) -> VirtualMachine:
    """A load that swings and is let go after 0.5 s, until it has landed."""
    plant = machine(*effects)
    pose = safe_pose()
    pose[4] -= 0.9
    drive(plant, step("boom", 0.0), 3.0, pose, opens_at_s=0.5)
    return plant


def landed(*effects: Fault) -> Array:
    point = throw(*effects).truth().impact_position_m[0]
    assert np.isfinite(point).all()
    return point


def test_release_is_late_and_slow() -> None:
    plain = throw().truth()
    late = throw(effect("release_delay", extra_delay_s=0.1)).truth()
    assert late.release_t_mono_ns[0] - plain.release_t_mono_ns[0] == pytest.approx(1e8, abs=1e3)
    slow = throw(effect("sticky_release", slowdown_ratio=0.3)).truth()
    speeds = [np.linalg.norm(t.release_velocity_m_per_s[0]) for t in (plain, slow)]
    assert speeds[1] / speeds[0] == pytest.approx(0.7, abs=0.03)


def test_jitter_spreads_the_release_without_moving_it() -> None:
    plant = machine(effect("release_jitter", extra_sd_s=0.08), count=200)
    plain = machine(count=200)
    delays = []
    for one in (plant, plain):
        drive(one, step("boom", 0.0), 0.8, opens_at_s=0.0)
        delays.append(one.truth().release_t_mono_ns * 1e-9)
    assert np.std(delays[0]) == pytest.approx(np.hypot(0.08, 0.015), rel=0.15)
    assert np.mean(delays[0]) == pytest.approx(np.mean(delays[1]), abs=0.02)


def test_flight_effects_move_the_impact() -> None:
    plain = landed()
    assert landed(effect("air_drag", extra_drag_coefficient_ratio=2.0))[0] < plain[0] - 0.01
    assert landed(effect("payload_mass", extra_mass_kg=4.0))[0] > plain[0]
    blown = landed(effect("wind", x_m_per_s=0.0, y_m_per_s=8.0))
    assert blown[1] > plain[1] + 0.05
    lifted = landed(effect("release_spin", spin_rad_per_s=30.0))
    assert lifted[0] > plain[0] + 0.01


def test_payload_offset_shifts_the_load_in_the_gripper() -> None:
    shifted = machine(effect("payload_offset", offset_x_m=0.1, offset_y_m=-0.2))
    plain = machine()
    for one in (shifted, plain):
        one.reset(safe_pose()[None], seed=3)
    moved = shifted.truth().ball_position_m[0] - plain.truth().ball_position_m[0]
    assert moved == pytest.approx([0.1, -0.2, 0.0], abs=2e-3)


def test_base_effects_turn_and_lift_everything() -> None:
    def ball(*effects: Fault) -> Array:
        plant = machine(*effects)
        plant.reset(safe_pose()[None], seed=3)
        return plant.truth().ball_position_m[0]

    x, y, z = ball()
    turned = ball(effect("base_yaw_drift", yaw_rad=0.1))
    assert turned == pytest.approx(
        [x * np.cos(0.1) - y * np.sin(0.1), x * np.sin(0.1) + y * np.cos(0.1), z], abs=1e-6
    )
    assert ball(effect("base_height", extra_height_m=0.2)) == pytest.approx([x, y, z + 0.2])
    # The gripper hangs plumb relative to the tilted arm at the reset: the whole machine turns.
    tilted = ball(effect("base_tilt", pitch_rad=0.05))
    assert z - tilted[2] == pytest.approx(0.05 * x, rel=0.1)


def test_the_chassis_gives_way_in_proportion_to_the_arm_moment() -> None:
    poses = sample_starts(SPEC, Mode.PLANAR, np.tile([8.0, 0.0, 0.0], (200, 1)), RNG)
    poses[:, 0] = 0.0
    reach = pin_in_plane(SPEC, poses)[:, 0]
    far, near = poses[reach.argmax()], poses[reach.argmin()]
    drops = []
    for pose in (far, near):
        heights = []
        for effects in ((), (effect("chassis_compliance", pitch_rad=0.05),)):
            plant = machine(*effects)
            plant.reset(pose[None], seed=3)
            heights.append(plant.truth().ball_position_m[0])
        drops.append((heights[0][2] - heights[1][2]) / heights[0][0])
        position, _ = drive(plant, step("boom", 0.0), 1.0, pose)
        # It starts at rest on its springs.
        assert np.abs(np.diff(position[:, 1:4], axis=0)).max() < 2e-3
    assert 0.02 < drops[0] < 0.055
    assert drops[1] < 0.6 * drops[0]


def test_sensor_faults_change_the_readings() -> None:
    plain, biased = machine(), machine(effect("joint_sensor_bias", "dipper", bias_rad_m=0.05))
    late = machine(effect("joint_sensor_latency", "boom", extra_latency_s=0.1))
    turned = machine(effect("imu_misalignment", roll_rad=0.0, pitch_rad=0.1, yaw_rad=0.0))
    samples = []
    for one in (plain, biased, late, turned):
        drive(one, step("boom", 0.5), 0.8)
        samples.append(one.read())
    seen = [s.joint_position_rad_m[0] for s in samples]
    assert seen[1] - seen[0] == pytest.approx([0.0, 0.0, 0.05, 0.0], abs=1.1e-3)
    speed = plain.truth().joint_velocity_rad_m_per_s[0, 1]
    assert seen[0][1] - seen[2][1] == pytest.approx(0.1 * speed, rel=0.15)
    # seen = R^T true: a sensor pitched by p finds gravity -g sin(p) on its x axis.
    change = (samples[3].imu_accel_m_per_s2 - samples[0].imu_accel_m_per_s2)[0]
    assert change[0] == pytest.approx(-9.81 * np.sin(0.1), abs=0.25)


def test_a_late_imu_shows_the_past() -> None:
    def gyro(*effects: Fault) -> Array:
        plant = machine(*effects)
        pose = safe_pose()
        pose[4] += 0.4
        plant.reset(pose[None], seed=3)
        seen = []
        for _ in range(100):
            plant.write(ValveCommand(np.zeros((1, 4)), np.zeros(1, dtype=bool)))
            plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
            seen.append(plant.read().imu_gyro_rad_per_s[0, 1])
        return np.array(seen)

    plain, late = gyro(), gyro(effect("imu_latency", extra_latency_s=0.1))
    assert np.abs(late[20:] - plain[10:-10]).max() < 0.05
    assert np.abs(late[20:] - plain[20:]).max() > 0.1


def test_drift_grows_from_the_first_to_the_last_throw() -> None:
    places = np.array([0.0, 0.5, 1.0])
    drifting = effect(DRIFT, "boom", **{"valve_dead_time.extra_dead_time_s": 0.2})
    plant = machine(drifting, count=3, places=places)
    plant.reset(np.tile(safe_pose(), (3, 1)), seed=3)
    onset = np.zeros(3)
    for tick in range(60):
        plant.write(ValveCommand(np.tile([0.0, 0.5, 0.0, 0.0], (3, 1)), np.zeros(3, dtype=bool)))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        moving = plant.truth().joint_velocity_rad_m_per_s[:, 1] > 0.08
        onset = np.where((onset == 0.0) & moving, tick * TICK_S, onset)
    assert np.diff(onset) == pytest.approx([0.1, 0.1], abs=0.02)


UNLISTED_SIZES = {
    "turntable_torsion": {"windup_rad": 0.03},
    "gain_oscillation": {"amplitude_ratio": 0.4, "frequency_hz": 1.5},
    "command_dropouts": {"rate_per_s": 3.0, "length_s": 0.2},
    "fading_hysteresis": {"half_width_ratio": 0.2, "travel_rad_m": 0.3},
    "gust": {"speed_m_per_s": 15.0},
    "uneven_claw": {"kick_x_m_per_s": 0.5, "kick_y_m_per_s": 0.5},
    "valve_crosstalk": {"leak_ratio": 0.3},
    "position_dependent_gain": {"loss_ratio": 0.8, "width_rad_m": 0.3},
    "command_steps": {"step_ratio": 0.4},
    "encoder_scale": {"error_ratio": 0.05},
}


def test_every_fault_off_the_table_changes_a_throw() -> None:
    def busy(t_s: float) -> Array:
        return np.array([0.5, 0.45, 0.0, 0.3]) * np.sign(np.sin(5.0 * t_s + 0.1))

    def outcome(*effects: Fault) -> Array:
        plant = machine(*effects)
        pose = safe_pose()
        pose[4] -= 0.9
        drive(plant, busy, 1.5, pose, opens_at_s=0.3)
        seen = plant.read().joint_position_rad_m[0]
        return np.concatenate([seen, plant.truth().impact_position_m[0]])

    plain, idle = outcome(), []
    for name, fault in UNLISTED_FAULTS.items():
        joint = "boom" if fault.joints else None
        change = outcome(effect(name, joint, **UNLISTED_SIZES[name])) - plain
        if not np.nanmax(np.abs(change)) > 5e-3:
            idle.append((name, change))
    assert not idle


def test_wrong_names_are_refused() -> None:
    with pytest.raises(PlantError, match="no effect 'gremlin'"):
        machine(effect("gremlin"))
    with pytest.raises(PlantError, match="needs one of"):
        machine(effect("backlash", gap_rad_m=0.01))
    with pytest.raises(PlantError, match="needs no joint"):
        machine(effect("wind", "boom", x_m_per_s=1.0))
    with pytest.raises(PlantError, match="has no parameter"):
        machine(effect("wind", z_m_per_s=1.0))
    with pytest.raises(PlantError, match="cannot drift"):
        leaning = Fault(DRIFT, None, {"base_tilt.roll_rad": 0.1})
        machine(leaning, count=2, places=np.array([0.0, 1.0]))


def test_columns_of_the_faults_are_consistent() -> None:
    for name, fault in FAULTS.items():
        assert fault.name == name
        assert fault.strength is None or fault.strength in fault.bounds
        assert all(low <= high for low, high in fault.bounds.values())
    assert not TABLE_FAULTS.keys() & UNLISTED_FAULTS.keys()


def test_every_effect_of_the_table_changes_a_throw() -> None:
    """An effect of the table without physics in the virtual machine would change nothing here."""

    def busy(t_s: float) -> Array:
        return np.array([0.5, 0.45, 0.3, 0.5]) * np.sign(np.sin(5.0 * t_s + 0.1))

    def outcome(*effects: Fault) -> Array:
        plant = machine(*effects)
        pose = safe_pose()
        pose[4:6] += (-0.9, 0.2)
        drive(plant, busy, 1.5, pose, opens_at_s=0.3)
        seen, truth = plant.read(), plant.truth()
        return np.concatenate(
            [
                seen.joint_position_rad_m[0],
                seen.imu_gyro_rad_per_s[0],
                truth.joint_position_rad_m[0],
                [truth.release_t_mono_ns[0] * 1e-9],
                truth.impact_position_m[0],
            ]
        )

    plain, idle = outcome(), []
    assert np.isfinite(plain).all()
    for name, fault in TABLE_FAULTS.items():
        joint = "boom" if fault.joints else None
        for parameter, (_, high) in fault.bounds.items():
            changed = outcome(effect(name, joint, **{parameter: high}))
            if not np.nanmax(np.abs(changed - plain)) > 1e-4:
                idle.append((name, parameter))
    assert not idle
