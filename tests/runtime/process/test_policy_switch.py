"""Offers of policy versions: loaded beside the loop, switched to while no plan is armed, told by events."""

import threading

import pytest

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.messages import ArmRequest, LeaseNotice, LoadRequest, ThrowState
from runtime.control.policy import PolicyRunner
from runtime.policies.puller import PolicyOffer
from runtime.process.policy_switch import LoadedPolicy, PolicySwitch
from tests.cases import each
from tests.runtime.machine_bench import SPEC, make
from tests.runtime.quick_policy import write_policy
from tests.waiting import wait_for

OFFER = PolicyOffer(mode=Mode.PLANAR, policy_sha256="a" * 64, deployment_count=1)


@pytest.fixture
def loaded(tmp_path):
    write_policy(tmp_path / "next-2d", Mode.PLANAR, 0.3)
    runner = PolicyRunner(tmp_path / "next-2d", SPEC)
    offer = PolicyOffer(mode=Mode.PLANAR, policy_sha256=runner.card.policy_sha256)
    return LoadedPolicy(offer, runner)


def given(switch, state=ThrowState.DISARMED):
    return wait_for(lambda: switch.next(state))


def policies_check(bench):
    checks = bench.control.machine_state().checks
    return next(check.text for check in checks if check.check_id == "policies")


def refuse(mode, policy_sha256):
    raise PolicyError(f"no {policy_sha256[:3]}")


@each("state", [s for s in ThrowState if s.value not in ("disarmed", "stopped", "fault")])
def test_nothing_is_loaded_while_a_plan_is_armed(state):
    calls = []
    switch = PolicySwitch(lambda *asked: calls.append(asked))
    switch.take(OFFER)
    assert all(switch.next(state) is None for _ in range(3))
    assert calls == []


def test_what_was_loaded_waits_until_no_plan_is_armed():
    ready = threading.Event()

    def load(mode, policy_sha256):
        ready.set()
        refuse(mode, policy_sha256)

    switch = PolicySwitch(load)
    switch.take(OFFER)
    assert switch.next(ThrowState.DISARMED) is None
    assert ready.wait(30.0)
    assert all(switch.next(ThrowState.ARMED) is None for _ in range(3))
    assert given(switch).refusal == "no aaa"
    assert switch.next(ThrowState.DISARMED) is None


def test_an_offer_that_a_rollback_has_ended_is_refused_without_a_look_at_its_files():
    calls = []
    switch = PolicySwitch(lambda *asked: calls.append(asked))
    switch.take(OFFER.model_copy(update={"refusal": "it was rolled back"}))
    found = given(switch)
    assert (found.runner, found.refusal, calls) == (None, "it was rolled back", [])


def test_a_newer_offer_replaces_the_one_that_is_being_loaded():
    go, asked = threading.Event(), []

    def load(mode, policy_sha256):
        asked.append(policy_sha256[:1])
        assert go.wait(30.0)
        refuse(mode, policy_sha256)

    switch = PolicySwitch(load)
    switch.take(OFFER)
    switch.next(ThrowState.DISARMED)
    switch.take(OFFER)  # repeated: the same
    newer = OFFER.model_copy(update={"policy_sha256": "b" * 64, "deployment_count": 2})
    switch.take(newer)
    go.set()
    assert given(switch).offer == newer
    assert asked == ["a", "b"]


def test_the_machine_throws_with_the_version_and_refuses_plans_of_the_one_before(bench, loaded):
    before = bench.plan()
    bench.control.use_policy(loaded)
    bench.tick()
    (event,) = bench.events
    sha256 = loaded.offer.policy_sha256
    assert event.kind == "policy_switched"
    assert (event.data["mode"], event.data["policy_sha256"]) == ("2d", sha256)
    state = bench.control.machine_state()
    assert state.policy_sha256["2d"] == sha256
    bench.tick(make(LeaseNotice, epoch_count=1))
    bench.ask(make(LoadRequest, epoch_count=1, seen_t_mono_ns=bench.driver.now_ns()))
    bench.ticks(20)
    arm = make(ArmRequest, epoch_count=1, plan=before, seen_t_mono_ns=bench.driver.now_ns())
    refused = bench.ask(arm)
    assert (refused.accepted, refused.reason) == (False, "policy_mismatch")
    plan = before.model_copy(update={"policy_sha256": sha256})
    arm = make(ArmRequest, epoch_count=1, plan=plan, seen_t_mono_ns=bench.driver.now_ns())
    assert bench.ask(arm).accepted


def test_a_version_that_cannot_be_used_is_told_and_the_one_on_board_stays(bench):
    before = bench.control.machine_state().policy_sha256
    bench.control.use_policy(LoadedPolicy(OFFER, None, "the file is cut off"))
    bench.tick()
    assert bench.kinds == ["policy_refused"]
    assert bench.events[0].data["detail"] == "the file is cut off"
    assert bench.control.machine_state().policy_sha256 == before
    bench.tick()
    assert bench.kinds == ["policy_refused"]


def test_a_version_that_is_no_longer_approved_is_taken_out_and_comes_back(bench):
    runner = bench.runners[Mode.PLANAR]
    again = PolicyOffer(mode=Mode.PLANAR, policy_sha256=None)
    bench.control.use_policy(LoadedPolicy(again, runner))
    bench.tick()
    assert bench.kinds == []
    for _ in range(2):
        bench.control.use_policy(LoadedPolicy(again, None, "it is not approved"))
        bench.tick()
    assert bench.kinds == ["policy_refused"]
    assert bench.events[0].data["is_removed"]
    assert "2d: none (it is not approved)" in policies_check(bench)
    assert list(bench.control.machine_state().policy_sha256) == ["3d"]
    bench.tick(make(LeaseNotice, epoch_count=1))
    bench.ask(make(LoadRequest, epoch_count=1, seen_t_mono_ns=bench.driver.now_ns()))
    bench.ticks(20)
    seen_ns = bench.driver.now_ns()
    refused = bench.ask(make(ArmRequest, epoch_count=1, plan=bench.plan(), seen_t_mono_ns=seen_ns))
    assert (refused.accepted, refused.reason) == (False, "policy_unusable")
    bench.control.use_policy(LoadedPolicy(again, runner))
    bench.tick()
    assert bench.kinds[-1] == "policy_switched"
    assert bench.events[-1].data["slot"] is None
    assert "2d" in bench.control.machine_state().policy_sha256
    assert "none" not in policies_check(bench)
