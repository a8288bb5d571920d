import numpy as np
import pytest

from machine.ballistics import drag_per_m, landing
from machine.errors import PlantError
from machine.kinematics import grip_centre, hanging_pitch_rad
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import SimulatedDriver, SimulatedPlantFactory, ValveCommand
from sim_twin.virtual.sensors import ACCEL_SD_M_PER_S2
from sim_twin.virtual_machine import START_NS, VirtualMachine
from tests.cases import each

SPEC = load_spec()
TICK_NS = 10_000_000


def pose(boom=0.8, dipper=0.1, telescope=0.4, slew=0.0):
    result = safe_pose(slew)
    result[1:4] = boom, dipper, telescope
    result[4] = hanging_pitch_rad(result)
    return result


def drive(machine, valve, ticks, *, is_open=False):
    """Hold a command; return the samples of all ticks."""
    command = ValveCommand(
        np.broadcast_to(np.asarray(valve, dtype=float), (machine.count, 4)),
        np.full(machine.count, is_open),
    )
    samples = []
    for _ in range(ticks):
        machine.write(command)
        machine.advance(machine.now_ns() + TICK_NS)
        samples.append(machine.read())
    return samples


def make(count=1, unit_seed=0, at=None, seed=1, **extra):
    machine = VirtualMachine(count=count, unit_seed=unit_seed, **extra)
    machine.reset(np.tile(pose() if at is None else at, (count, 1)), seed)
    return machine


def test_it_is_a_simulated_driver_and_its_class_a_plant_factory():
    factory: SimulatedPlantFactory = VirtualMachine
    machine = factory(count=2, unit_seed=0)
    assert isinstance(machine, SimulatedDriver)
    assert machine.now_ns() == START_NS == 1_000_000_000
    machine.close()


def test_at_rest_it_stands_still_and_its_sensors_say_so():
    machine = make(count=40)
    samples = drive(machine, np.zeros(4), 100)
    truth = machine.truth()
    np.testing.assert_allclose(truth.joint_position_rad_m, np.tile(pose(), (40, 1)), atol=3e-3)
    last = samples[-1]
    assert last.t_mono_ns == machine.now_ns() - 4_000_000
    assert np.abs(last.joint_position_rad_m - pose()[:4]).max() < 0.01
    assert np.abs(last.joint_velocity_rad_m_per_s).max() < 0.05
    assert last.payload_held.all() and last.local_enable.all() and not last.emergency_stop.any()
    assert (last.impact_t_mono_ns == 0).all() and (last.ball_t_mono_ns == 0).all()
    np.testing.assert_allclose(last.supply_pressure_pa, 35e6, rtol=0.02)
    accel = np.array([s.imu_accel_m_per_s2 for s in samples])
    np.testing.assert_allclose(accel.mean((0, 1)), [0.0, 0.0, 9.81], atol=0.01)
    assert accel.std((0, 1)).max() < 2.0 * ACCEL_SD_M_PER_S2
    assert not machine.collided().any()


@each("joint", range(4))
@each("sign", [1, -1])
def test_a_positive_valve_moves_the_joint_positively_after_a_dead_time(joint, sign):
    machine = make(at=pose(0.8, 0.2, 0.6))
    valve = np.zeros(4)
    valve[joint] = 0.6 * sign
    drive(machine, valve, 5)
    early = machine.truth().joint_position_rad_m[0, joint] - pose(0.8, 0.2, 0.6)[joint]
    assert abs(early) < 1e-3
    drive(machine, valve, 55)
    moved = machine.truth().joint_position_rad_m[0, joint] - pose(0.8, 0.2, 0.6)[joint]
    assert sign * moved > 0.03


def test_true_grip_centre_agrees_with_the_shared_kinematics_on_the_nominal_unit():
    machine = make(count=30)
    for k in range(40):
        drive(machine, [0.5, -0.3, 0.6 * np.cos(k / 6), 0.3], 1)
    truth = machine.truth()
    tool = grip_centre(SPEC, truth.joint_position_rad_m, truth.joint_velocity_rad_m_per_s)
    offset = np.linalg.norm(truth.ball_position_m - tool.position_m, axis=1)
    assert ((offset > 0.008) & (offset < 0.022)).all()  # the grasp, 1-2 cm
    assert np.abs(truth.ball_velocity_m_per_s - tool.velocity_m_per_s).max() < 0.08


def test_specific_force_is_that_of_the_moving_imu():
    machine = make(count=1, at=pose(0.8, -0.2, 0.4), tracker=False)
    machine.reset(pose(0.8, -0.2, 0.4)[None], 4)
    body = machine._body.model
    site = body.site("imu").pos
    period_s, points, times, seen = 0.002, [], [], {}
    for k in range(400):
        if k % 5 == 0:
            valve = np.array([[0.8, 0.3, 0.8 * np.sign(np.sin(k / 50)), 0.0]])
            machine.write(ValveCommand(valve, np.zeros(1, bool)))
        machine.advance(machine.now_ns() + 2_000_000)
        grip = machine._grip_motion()
        arm = grip.rotation[0] @ (site + np.array([0.0, 0.0, 1.0]))
        points.append(grip.position_m[0] + arm)
        times.append((grip.time_ns, grip.rotation[0].copy()))
        sample = machine.read()
        seen[int(sample.imu_t_mono_ns[0])] = sample.imu_accel_m_per_s2[0].copy()
    points = np.array(points)
    acceleration = (points[2:] - 2 * points[1:-1] + points[:-2]) / period_s**2
    errors = []
    for k, (time_ns, rotation) in enumerate(times[1:-1]):
        if time_ns in seen:
            force = rotation.T @ (acceleration[k] + [0.0, 0.0, 9.81])
            errors.append(seen[time_ns] - force)
    errors = np.array(errors)
    assert len(errors) > 60
    assert np.ptp(acceleration[:, 0]) > 4.0
    assert np.abs(np.median(errors, axis=0)).max() < 0.05
    assert np.sqrt((errors**2).mean(0)).max() < 0.35  # differences are one-sided in time


def throw(machine, wait=0):
    """Swing outward and open on the way; run until everything has been surveyed."""
    drive(machine, [0, 0, -0.7, 0], 40)
    drive(machine, [0, 0, 1, 0], 20)
    opened_ns = machine.now_ns()
    drive(machine, [0, 0, 1, 0], 40, is_open=True)
    samples = drive(machine, np.zeros(4), 160 + wait, is_open=True)
    return opened_ns, samples


def test_release_flight_and_survey():
    machine = make(count=40)
    machine.set_surface_height(np.repeat([0.5, 0.0], 20))
    opened_ns, samples = throw(machine)
    truth, last = machine.truth(), samples[-1]
    assert not machine.collided().any()
    delay_s = (truth.release_t_mono_ns - opened_ns) * 1e-9
    assert delay_s.mean() == pytest.approx(0.258, abs=0.010)
    assert 0.008 < delay_s.std() < 0.022
    fall = landing(
        truth.release_position_m,
        truth.release_velocity_m_per_s,
        machine.target_height_m + SPEC.ball.radius_m,
        drag_per_m(SPEC.ball),
    )
    np.testing.assert_allclose(truth.impact_position_m[:, :2], fall.position_m[:, :2], atol=1e-3)
    np.testing.assert_array_equal(truth.impact_position_m[:, 2], machine.target_height_m)
    flight_s = (truth.impact_t_mono_ns - truth.release_t_mono_ns) * 1e-9
    np.testing.assert_allclose(flight_s, fall.time_s, atol=1e-4)
    np.testing.assert_array_equal(last.impact_t_mono_ns, truth.impact_t_mono_ns)
    np.testing.assert_array_equal(machine.true_impact_m(), truth.impact_position_m)
    error = last.impact_position_m - truth.impact_position_m
    assert 0.01 < error[:, :2].std() < 0.03
    np.testing.assert_allclose(last.impact_sd_m, 0.02)
    assert not last.payload_held.any()
    assert (last.ball_t_mono_ns > 0).all()


def test_switch_opens_shortly_after_the_load_has_left_and_the_survey_later_still():
    machine = make(count=8)
    opened_ns, samples = throw(machine)
    truth = machine.truth()
    history = drive(machine, np.zeros(4), 1)
    assert not history[0].payload_held.any()
    for copy in range(8):
        for sample in samples:
            if sample.impact_t_mono_ns[copy]:
                known_ns = sample.t_mono_ns - truth.impact_t_mono_ns[copy]
                assert known_ns > 0.48e9
                break
    assert (truth.release_t_mono_ns > opened_ns + 0.2e9).all()


def test_a_new_load_starts_afresh_and_needs_a_new_opening():
    machine = make(count=3)
    throw(machine)
    machine.load()
    sample = drive(machine, np.zeros(4), 1, is_open=True)[0]  # still commanded open: no edge
    assert sample.payload_held.all()
    assert (sample.impact_t_mono_ns == 0).all() and (sample.ball_t_mono_ns == 0).all()
    drive(machine, np.zeros(4), 40, is_open=True)
    assert (machine.truth().release_t_mono_ns == 0).all()
    drive(machine, np.zeros(4), 2)
    drive(machine, np.zeros(4), 40, is_open=True)
    assert (machine.truth().release_t_mono_ns > 0).all()


def test_a_command_taken_back_before_the_claws_open_keeps_the_load():
    machine = make()
    drive(machine, np.zeros(4), 10, is_open=True)
    sample = drive(machine, np.zeros(4), 60)[-1]
    assert sample.payload_held.all()


def test_without_commands_the_watchdog_closes_the_valves():
    machine = make(at=pose(telescope=0.3))
    drive(machine, [0, 0, 0, 0.8], 40)
    assert machine.truth().joint_velocity_rad_m_per_s[0, 3] > 0.2
    machine.advance(machine.now_ns() + 80_000_000)
    assert machine.truth().joint_velocity_rad_m_per_s[0, 3] > 0.2
    machine.advance(machine.now_ns() + 620_000_000)
    assert abs(machine.truth().joint_velocity_rad_m_per_s[0, 3]) < 0.01


@each("switch", ["enable", "stop"])
def test_enable_switch_and_emergency_stop_close_the_valves(switch):
    machine = make(count=2, at=pose(telescope=0.3))
    if switch == "enable":
        machine.set_local_enable(np.array([False, True]))
    else:
        machine.set_emergency_stop(np.array([True, False]))
    sample = drive(machine, [0, 0, 0, 0.8], 50)[-1]
    speed = machine.truth().joint_velocity_rad_m_per_s[:, 3]
    assert abs(speed[0]) < 0.01 and speed[1] > 0.2
    assert sample.local_enable[0] == (switch != "enable")
    assert sample.emergency_stop[0] == (switch == "stop")


def test_the_same_seed_repeats_every_bit_and_another_does_not():
    traces = []
    for seed in (3, 3, 4):
        machine = make(count=40, unit_seed=2, seed=seed)
        samples = drive(machine, [0.5, 0.2, -0.4, 0.3], 30)
        traces.append((machine.truth().joint_position_rad_m, samples[-1].joint_position_rad_m))
    assert np.array_equal(traces[0][0], traces[1][0])
    assert np.array_equal(traces[0][1], traces[1][1])
    assert not np.array_equal(traces[0][0], traces[2][0])


def test_a_reset_forgets_what_was_before():
    machine = make(count=3, seed=9)
    first = drive(machine, [0.4, 0.1, 0.5, 0.2], 40)[-1].joint_position_rad_m
    throw(machine)
    machine.reset(np.tile(pose(), (3, 1)), 9)
    again = drive(machine, [0.4, 0.1, 0.5, 0.2], 40)[-1].joint_position_rad_m
    np.testing.assert_array_equal(first, again)


def test_units_move_differently():
    ends = []
    for unit_seed in (0, 1, 2):
        machine = make(unit_seed=unit_seed)
        drive(machine, [0.5, 0.3, -0.5, 0.4], 80)
        ends.append(machine.truth().joint_position_rad_m[0, :4])
    assert (np.ptp(np.array(ends), axis=0) > 2e-3).all()


def test_lowering_the_gripper_to_the_ground_is_a_collision():
    machine = make(count=2, at=pose(0.6, 0.3, 0.2))
    assert not machine.collided().any()
    valves = np.zeros((2, 4))
    valves[1, 1] = -1.0
    drive(machine, valves, 120)
    assert machine.collided().tolist() == [False, True]
    machine.reset(np.tile(pose(), (2, 1)), 1)
    assert not machine.collided().any()


def test_the_imu_is_late_and_the_tracker_can_be_left_out():
    machine = make(count=50, tracker=False)
    ages = []
    for sample in throw(machine)[1]:
        ages.append((sample.t_mono_ns + 4_000_000 - sample.imu_t_mono_ns) * 1e-9)
        assert (sample.ball_t_mono_ns == 0).all() and np.isnan(sample.ball_position_m).all()
    ages = np.array(ages)
    assert ages.min() >= 0.015
    assert 0.020 < np.median(ages) < 0.035
    assert ages.max() > 0.036  # a lost packet


def test_wrong_calls_are_refused_with_the_numbers():
    with pytest.raises(PlantError, match="count >= 1"):
        VirtualMachine(count=0, unit_seed=0)
    machine = make()
    with pytest.raises(PlantError, match="go back"):
        machine.advance(machine.now_ns() - 1)
    with pytest.raises(PlantError, match=r"\(1, 4\)"):
        machine.write(ValveCommand(np.zeros((2, 4)), np.zeros(2, bool)))
    with pytest.raises(PlantError, match="finite"):
        machine.write(ValveCommand(np.full((1, 4), np.nan), np.zeros(1, bool)))
    with pytest.raises(PlantError, match="gripper"):
        machine.write(ValveCommand(np.zeros((1, 4)), np.zeros(2, bool)))
    with pytest.raises(PlantError, match=r"\(1, 6\)"):
        machine.reset(np.zeros((1, 5)), 0)


def moved_while(machine, command_of, ticks=60):
    """Way of the dipper (N,) from the twentieth tick on, under the commands of each tick."""
    start = 0.0
    for tick in range(ticks):
        machine.write(command_of(tick))
        machine.advance(machine.now_ns() + TICK_NS)
        if tick == 29:
            start = machine.truth().joint_position_rad_m[:, 2].copy()
    return np.abs(machine.truth().joint_position_rad_m[:, 2] - start)


def test_a_counter_that_stands_still_closes_the_valves_although_writes_go_on():
    valve, shut = np.array([[0.0, 0.0, 0.6, 0.0]]), np.zeros(1, bool)
    going = moved_while(make(), lambda tick: ValveCommand(valve, shut, alive_count=tick))
    standing = moved_while(make(), lambda tick: ValveCommand(valve, shut, alive_count=min(tick, 5)))
    without = moved_while(make(), lambda tick: ValveCommand(valve, shut))
    assert going[0] > 0.05 and without[0] > 0.05
    assert standing[0] < 0.01


def test_without_supply_no_joint_moves_whatever_its_valve_says():
    valve, shut = np.tile([0.0, 0.0, 0.6, 0.0], (2, 1)), np.zeros(2, bool)
    supply = np.array([True, False])
    way = moved_while(make(count=2), lambda _: ValveCommand(valve, shut, supply_enabled=supply))
    assert way[0] > 0.05 and way[1] < 0.01
