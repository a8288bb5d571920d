"""One machine under control, without processes: what ticks give, and what faults around them do."""

import re

import numpy as np
import pytest

from machine.conventions import Mode, Motion
from machine.errors import PolicyError
from machine.messages import (
    AimShift,
    ArmRequest,
    FireRequest,
    LeaseNotice,
    LoadRequest,
    StopClearRequest,
    StopRequest,
    Target,
    ThrowState,
    ZonesRequest,
)
from machine.site.zones import ZoneSet
from runtime.guard.zones import arm_points
from runtime.process import machine_control
from runtime.throw.protocol import Latch, LinkLost
from tests.runtime.fake_driver import IMPACT_M
from tests.runtime.guard.test_guard_zones import ELLIPSE, box
from tests.runtime.machine_bench import SPEC, Bench, make


@pytest.mark.parametrize("mode", list(Mode))
def test_a_throw_gives_events_rows_and_its_release(bench, mode):
    nonce = bench.arm(mode)
    assert bench.ask(bench.fire_command(nonce, mode=mode)).accepted
    bench.hold_until("throw_ended")
    assert bench.kinds[-5:] == [
        "throw_accepted",
        "throw_started",
        "release_commanded",
        "impact",
        "throw_ended",
    ]
    impact, end = bench.events[-2:]
    assert tuple(impact.data["position_m"]) == IMPACT_M
    assert end.data["outcome"] == "landed"
    # The quick policy opens the dipper slowly: the load leaves at about half a metre a second.
    assert 0.2 < end.data["release_speed_m_per_s"] < 1.5
    assert np.isfinite(end.data["release_position_m"]).all()
    logged = bench.reports[[r.log_begins is not None for r in bench.reports].index(True) :]
    context = logged[0].log_begins
    assert (context["throw_id"], context["mode"]) == ("t1", mode.value)
    assert context["plan_hash"] == bench.plan(mode).plan_hash
    assert logged[-1].log_ends["outcome"] == "landed"
    ticks = [int(report.rows["control"]["tick_count"][0]) for report in logged]
    assert ticks == list(range(len(logged)))
    assert sum("policy" in report.rows for report in logged) > 5
    assert sum("ball" in report.rows for report in logged) == pytest.approx(60, abs=3)


def test_what_stands_around_reaches_a_driver_that_simulates_the_landing(bench):
    given = []
    bench.driver.set_solids = given.append
    bench.arm()
    assert [solids.names for solids in given] == [("surface at the target's height",)]
    assert given[0].ground_m == 0.5  # nothing of that height is described: the ground is


def test_stale_fire_is_refused_reported_and_leaves_the_machine_armed(bench):
    fire = bench.fire_command(bench.arm())
    bench.ticks(101)
    reply = bench.ask(fire)
    assert (reply.accepted, reply.reason) == (False, "command_stale")
    assert "on its way" in reply.detail
    assert bench.control.throw.state is ThrowState.ARMED
    assert bench.events[-1].data["reason"] == "command_stale"
    fresh = fire.model_copy(update={"seen_t_mono_ns": bench.driver.now_ns()})
    assert bench.ask(fresh).accepted


def test_stale_repeat_of_an_executed_fire_is_answered_as_a_repeat(bench):
    fire = bench.fire_command(bench.arm())
    assert bench.ask(fire).accepted
    bench.ticks(300)
    again = bench.ask(fire)
    assert (again.accepted, again.is_repeat) == (True, True)


def test_stale_heartbeats_do_not_count_but_letting_go_does(bench):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    old_ns = bench.driver.now_ns() - 600_000_000
    for _ in range(10):
        bench.tick(bench.beat(seen_t_mono_ns=old_ns))
    assert bench.control.throw.heartbeat_ns == 0
    bench.tick(bench.beat(is_holding=False, seen_t_mono_ns=old_ns))
    assert bench.events[-1].data["reason"] == "the operator let go"


def test_blind_loop_ends_a_throw_before_its_commit_point(bench):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    bench.hold_until("throw_started")
    bench.tick(bench.beat(), skipped=9)
    assert bench.control.throw.state is ThrowState.THROWING
    bench.tick(bench.beat(), skipped=10)
    assert "stood still for 100 ms" in bench.events[-1].data["reason"]


def test_blind_loop_gives_back_what_is_armed_before_a_fire_that_came_meanwhile(bench):
    fire = bench.fire_command(bench.arm())
    bench.tick(fire, skipped=10)
    assert bench.control.throw.state is ThrowState.DISARMED
    assert [event.kind for event in bench.events[-2:]] == ["disarmed", "command_refused"]


class SleepingClock:
    """The fake driver while the computer is suspended: its clock does not go on."""

    def __init__(self, driver) -> None:
        self._advance, driver.advance = driver.advance, self._sleep

    def wake(self, driver) -> None:
        driver.advance = self._advance

    def _sleep(self, until_ns) -> None:
        return


@pytest.mark.parametrize("ticks_after", [0, 3])
@pytest.mark.parametrize("verb", ["arm", "load", "clear"])
def test_what_was_sent_before_the_computer_slept_is_refused_after_it(bench, verb, ticks_after):
    bench.arm()
    bench.ask(make(StopRequest))
    latch_id = bench.control.throw.latch_id
    clear = {"latch_id": latch_id, "sighted_by": "olga", "reason": "nobody near"}

    def command():
        head = {"epoch_count": 1, **bench.seen()}
        kinds = {
            "arm": lambda: make(ArmRequest, plan=bench.plan(), **head),
            "load": lambda: make(LoadRequest, **head),
            "clear": lambda: make(StopClearRequest, **head, **clear),
        }
        return kinds[verb]()

    if verb != "clear":
        assert bench.ask(make(StopClearRequest, epoch_count=1, **bench.seen(), **clear)).accepted
    early = command()
    asleep = SleepingClock(bench.driver)
    messages = [] if ticks_after else [early]
    report = bench.tick(*messages, skipped=360_000)
    asleep.wake(bench.driver)
    bench._period -= 360_000  # neither the grid nor the machine's clock went on
    for left in range(ticks_after - 1, -1, -1):
        report = bench.tick(*([] if left else [early]))
    ((_, reply),) = report.replies
    assert (reply.accepted, reply.reason) == (False, "command_stale")
    assert "its computer slept" in reply.detail
    bench.tick()
    assert bench.ask(command()).accepted


def test_policy_that_takes_too_long_aborts_the_throw_and_says_so(bench, monkeypatch):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    bench.hold_until("throw_started")
    runner = bench.runners[Mode.PLANAR]
    infer = runner.infer

    def late(observation):
        action = infer(observation)
        runner.is_late = True
        return action

    monkeypatch.setattr(runner, "infer", late)
    bench.hold_until("aborted")
    (aborted,) = [event for event in bench.events if event.kind == "aborted"]
    assert "the policy took too long" in aborted.data["reason"]
    assert bench.control.throw.motion is Motion.HOLD
    assert "release_commanded" not in bench.kinds


def test_policy_that_cannot_run_closes_the_valves_and_latches_a_fault(bench, monkeypatch):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    bench.hold_until("throw_started")

    def fail(*_):
        raise PolicyError("the policy cannot run")

    monkeypatch.setattr("runtime.process.machine_control.step", fail)
    bench.tick(bench.beat())
    assert not bench.driver.commands[-1].valve_ratio.any()
    bench.tick(bench.beat())
    assert bench.control.throw.state is ThrowState.FAULT
    assert bench.control.machine_state().fault == "the policy cannot run"
    assert bench.kinds[-2:] == ["fault", "throw_ended"]


@pytest.mark.parametrize(
    ("moment", "outcome"), [("throw_started", "aborted"), ("release_commanded", "landed")]
)
def test_lost_link_lets_go_before_and_completes_after_the_commit_point(bench, moment, outcome):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    bench.hold_until(moment)
    bench.tick(LinkLost())
    for _ in range(3000):
        if "throw_ended" in bench.kinds:
            break
        bench.tick()
    assert bench.events[-1].data["outcome"] == outcome


def test_log_waits_for_the_impact_of_a_load_still_in_the_air(bench):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    bench.hold_until("release_commanded")
    bench.ticks(30)
    assert bench.ask(make(StopRequest)).accepted
    assert bench.control.throw.state is ThrowState.STOPPED
    bench.ticks(100)
    assert bench.kinds[-3:] == ["stop_latched", "throw_ended", "impact"]
    ended = [r for r in bench.reports if r.log_ends is not None]
    assert [r.log_ends["outcome"] for r in ended] == ["stopped"]
    assert bench.control.is_waiting


def test_memory_of_earlier_boots_keeps_epoch_and_throws(bench):
    bench.control.remember(7, ("old-1", "old-2"), None)
    bench.tick()
    assert bench.ask(make(LeaseNotice, epoch_count=6)).reason == "stale_epoch"
    fire = make(
        FireRequest, epoch_count=7, throw_id="old-1", nonce="n", plan_hash="h",
        seen_t_mono_ns=bench.driver.now_ns(),
    )  # fmt: skip
    reply = bench.ask(fire)
    assert (reply.accepted, reply.is_repeat, reply.throw_id) == (True, True, "old-1")
    assert bench.control.throw.state is ThrowState.DISARMED


def test_state_message_says_what_is_on_board(bench):
    bench.ticks(11)
    state = bench.control.machine_state()
    assert state.boot_id == "boot"
    assert set(state.policy_sha256) == {"2d", "3d"}
    assert {check.check_id for check in state.checks} >= {"payload", "local_enable", "gripper_imu"}
    assert state.heartbeat_age_s is None
    bench.arm()
    assert bench.control.machine_state().mode is Mode.PLANAR


def test_emergency_stop_and_silent_imu_are_seen(bench):
    bench.driver.imu_is_silent = True
    bench.ticks(30)
    failed = [c.check_id for c in bench.control.machine_state().checks if not c.passed]
    assert "gripper_imu" in failed
    bench.driver.emergency_stop = True
    bench.tick()
    assert bench.control.throw.state is ThrowState.STOPPED


def test_close_shuts_the_valves(bench: Bench):
    bench.control.close()
    assert bench.driver.is_closed
    assert not bench.driver.commands[-1].valve_ratio.any()


def test_a_machine_that_remembers_nothing_is_stopped(quick_policies):
    bench = Bench(quick_policies, is_known=False)
    bench.ticks(20)
    assert bench.control.throw.state is ThrowState.STOPPED
    state = bench.control.machine_state()
    assert state.stop_latched and state.latch_id == "boot.0"
    assert "not been read" in state.latched_reason
    # A stop that comes before the records is newer than what they say.
    assert bench.ask(make(StopRequest)).latch_id == "boot.1"
    bench.control.remember(4, (), None)
    assert bench.control.throw.state is ThrowState.STOPPED
    assert bench.control.throw.epoch_count == 4


def test_a_latch_of_an_earlier_process_is_taken_over(quick_policies):
    bench = Bench(quick_policies, is_known=False)
    bench.control.remember(4, (), Latch("old.3", ThrowState.FAULT, "a hose burst"))
    bench.ticks(5)
    state = bench.control.machine_state()
    assert (state.state, state.latch_id, state.fault) == (
        ThrowState.FAULT,
        "old.3",
        "a hose burst",
    )


def test_a_release_that_would_land_elsewhere_ends_the_throw_with_the_load_held(bench):
    near = bench.plan().model_copy(update={"allowed_radius_m": 0.5})
    bench.plan = lambda mode=Mode.PLANAR: near
    nonce = bench.arm()
    assert bench.ask(bench.fire_command(nonce)).accepted
    bench.hold_until("throw_ended")
    assert "release_commanded" not in bench.kinds
    (aborted,) = [event for event in bench.events if event.kind == "aborted"]
    assert "outside the plan's region" in aborted.data["reason"]
    assert not any(command.gripper_open.any() for command in bench.driver.commands)


def test_enable_off_in_the_tick_of_the_release_keeps_the_load_and_the_commit_point_away(
    quick_policies,
):
    def throw(disable_at: int) -> tuple[Bench, int]:
        """A throw without the enable switch from a tick on; the tick in which the gripper opens, or -1."""
        bench = Bench(quick_policies)
        assert bench.ask(bench.fire_command(bench.arm())).accepted
        for tick in range(3000):
            bench.driver.local_enable = tick < disable_at
            bench.tick(bench.beat())
            if bench.driver.commands[-1].gripper_open.any():
                return bench, tick
            if "throw_ended" in bench.kinds:
                return bench, -1
        raise AssertionError(bench.kinds)

    bench, release_tick = throw(3000)
    assert bench.control.throw.state is ThrowState.THROWING
    bench.tick(bench.beat())
    assert bench.control.throw.state is ThrowState.COMMITTED
    bench, tick = throw(release_tick)
    assert tick == -1
    assert "release_commanded" not in bench.kinds
    assert bench.events[-1].data["outcome"] == "aborted"
    assert "enable switch" in bench.events[-1].data["detail"]


def test_a_joint_moved_from_outside_latches_a_fault(bench):
    nonce = bench.arm()
    assert bench.ask(bench.fire_command(nonce)).accepted
    bench.hold_until("throw_started")
    bench.driver._q[1] += 0.3
    bench.hold_until("fault")
    assert "contradicts its velocity" in bench.control.throw.latched_reason
    assert not bench.driver.commands[-1].valve_ratio.any()
    assert not bench.driver.commands[-1].supply_enabled.any()


def test_a_log_context_before_any_plan(bench):
    context = bench.control.log_context()
    assert context["throw_id"] is None and "plan" not in context
    assert bench.control.log_throw_id is None


def test_samples_that_come_while_a_tick_is_held_up_are_not_of_the_future(bench, monkeypatch):
    driver = bench.driver
    read = driver.read
    held_up_ns = [*[0] * 20, *[8_000_000] * 3, *[0] * 3, *[30_000_000] * 3, *[0] * 3]
    waits_ns = iter(held_up_ns)

    def read_late():
        driver._now_ns += next(waits_ns)
        return read()

    monkeypatch.setattr(driver, "read", read_late)
    bench.ticks(len(held_up_ns))
    assert all(command.supply_enabled[0] for command in driver.commands[-12:])


def test_commands_carry_a_counter_that_goes_on(bench):
    bench.ticks(5)
    counts = [command.alive_count for command in bench.driver.commands]
    assert counts == list(range(5))
    assert all(command.supply_enabled.all() for command in bench.driver.commands)


def test_an_impact_without_a_throw_is_nobody_s(bench):
    bench.driver._left_ns = 1
    bench.ticks(80)
    assert "impact" not in bench.kinds


def test_zones_are_taken_checked_and_keep_the_arm_still(bench):
    office = ZoneSet(version_count=3, zones=(box(8.0, 0.0, top_m=2.0),))
    bench.arm()
    assert bench.ask(make(ZonesRequest, zone_set=office, **bench.seen())).accepted
    assert bench.kinds[-1] == "disarmed"
    assert bench.control.machine_state().zones_sha256 == office.sha256
    bench.ticks(2)

    def arm(**changes):
        plan = bench.plan().model_copy(update=changes)
        return bench.ask(make(ArmRequest, epoch_count=1, plan=plan, **bench.seen()))

    assert arm().reason == "zones_mismatch"
    named = {"zones_sha256": office.sha256}
    assert "how its landings scatter" in arm(**named).detail
    inside = arm(**named, predicted_ellipse=ELLIPSE)
    assert inside.reason == "target_in_zone"
    assert re.search(
        r"reaches 0\.\d\d m into zone 'Office', which is kept free up to 2.0 m", inside.detail
    )
    near = {**named, "predicted_ellipse": ELLIPSE, "target": Target(x_m=6.3, y_m=0.0, z_m=0.5)}
    # Beside the zone, but aimed into it.
    shift = AimShift(
        version_count=1,
        downrange_m=-0.6,
        crossrange_m=0.0,
        policy_sha256=bench.plan().policy_sha256,
        calibration_sha256=bench.control.machine_state().calibration_sha256,
    )
    assert arm(**near, aim=shift).reason == "target_in_zone"
    # The motion from where the arm stands, past the zone and through it; and from elsewhere.
    assert "how the arm moves" in arm(**near).detail
    stands = np.array(bench.control.machine_state().joint_position_rad_m)
    away, around_it = np.linspace(0.0, [[1.0, 0, 0, 0, 0, 0]], 9)[:, 0], np.zeros((9, 6))
    around_it[:, 3] = np.linspace(0.0, 3.0, 9)
    low = around_it + np.linspace(0.0, [[0.0, -0.6, 1.2, 0, -0.6, 0]], 9)[:, 0]
    paths = [tuple(map(tuple, (stands + offset).tolist())) for offset in (away, low, away + 0.06)]
    through = arm(**near, swept_path_rad_m=paths[1])
    assert "within 0.10 m of zone 'Office'" in through.detail
    elsewhere = arm(**near, swept_path_rad_m=paths[2])
    assert "0.06 rad or m from where it stood" in elsewhere.detail
    beside = arm(**near, swept_path_rad_m=paths[0])
    assert beside.accepted, beside.detail
    here = arm_points(
        SPEC, np.array([bench.control.machine_state().joint_position_rad_m])
    ).position_m[0, -1]
    around = ZoneSet(version_count=4, zones=(box(float(here[0]), float(here[1]), top_m=9.0),))
    assert bench.ask(make(ZonesRequest, zone_set=around, **bench.seen())).accepted
    (check,) = (c for c in bench.control.machine_state().checks if c.check_id == "exclusion_zones")
    assert not check.passed and "zone 'Office'" in check.text


def test_an_aim_correction_moves_what_the_policy_is_given_and_not_the_region(bench, monkeypatch):
    """Only with the policy and the calibration on board; the load may come down around the target alone."""
    given = []

    def spied(params, state, inputs, now_ns):
        given.append(inputs)
        return real(params, state, inputs, now_ns)

    real = machine_control.step
    monkeypatch.setattr(machine_control, "step", spied)
    bench.ticks(5)
    bench.ask(make(LeaseNotice, epoch_count=1))
    bench.ask(make(LoadRequest, epoch_count=1, **bench.seen()))
    bench.ticks(12)
    plan, state = bench.plan(), bench.control.machine_state()
    aim = AimShift(
        version_count=2,
        downrange_m=0.2,
        crossrange_m=-0.1,
        policy_sha256=plan.policy_sha256,
        calibration_sha256=state.calibration_sha256,
    )

    def arm(target=plan.target, **changes):
        held = plan.model_copy(update={"target": target, "aim": aim.model_copy(update=changes)})
        return bench.ask(make(ArmRequest, epoch_count=1, plan=held, **bench.seen()))

    for wrong in ({"calibration_sha256": "0" * 64}, {"policy_sha256": "0" * 64}):
        refused = arm(**wrong)
        assert (refused.accepted, refused.reason) == (False, "aim_mismatch")
        assert "Aim correction v2 is of policy" in refused.detail
    card = bench.runners[plan.mode].card
    near = Target(x_m=card.target_range_min_m + 0.1, y_m=0.0, z_m=plan.target.z_m)
    assert arm(near).detail.startswith("With aim correction v2: ")
    assert arm().accepted
    bench.ticks(2)
    target = np.array([[plan.target.x_m, plan.target.y_m, plan.target.z_m]])
    assert np.array_equal(given[-1].target_m, target)
    moved = given[-1].given_target_m - target
    along = target[0, :2] / np.hypot(*target[0, :2])
    assert moved[0, :2] @ along == pytest.approx(-0.2)
    assert moved[0, :2] @ (-along[1], along[0]) == pytest.approx(0.1)
    assert moved[0, 2] == 0.0


def test_a_machine_that_cannot_read_its_zones_does_not_arm(quick_policies):
    bench = Bench(quick_policies, is_known=False)
    bench.control.remember(0, (), None, None)
    bench.ticks(5)
    bench.ask(make(LeaseNotice, epoch_count=1))
    bench.ask(make(LoadRequest, epoch_count=1, **bench.seen()))
    bench.ticks(12)
    refused = bench.ask(make(ArmRequest, epoch_count=1, plan=bench.plan(), **bench.seen()))
    assert (refused.accepted, refused.reason) == (False, "zones_mismatch")
    assert bench.control.machine_state().zones_sha256 is None
    sent = make(ZonesRequest, zone_set=ZoneSet(version_count=1), **bench.seen())
    assert bench.ask(sent).accepted
    assert bench.ask(make(ArmRequest, epoch_count=1, plan=bench.plan(), **bench.seen())).accepted
