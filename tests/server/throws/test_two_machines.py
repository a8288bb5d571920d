"""What a person holds of one machine moves no other."""

import time

import pytest

from machine.messages import ThrowState
from tests.server.hold_client import Hold
from tests.server.server_bench import wait_for
from tests.server.throws.test_throw_service import code, ended, make_plan


@pytest.fixture
def other(running):
    """Machine m002, connected and disarmed."""
    with running.machine("m002") as fake:
        wait_for(lambda: running.parts.registry.is_connected("m002"))
        yield fake
    wait_for(lambda: not running.parts.registry.is_connected("m002"))


def test_the_lease_of_another_machine_is_none(running, machine, other, ada):
    with running.client("bob") as bob:
        assert bob.post("/machines/m002/lease").status_code == 200
        assert ada.post("/machines/m001/lease").status_code == 200
        plan_id = make_plan(ada)
        assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
        for path in ("arm", "fire"):
            assert code(bob.post(f"/plans/{plan_id}/{path}", json={})) == (403, "no_lease")
        for path in ("load", "abort", "disarm"):
            assert code(bob.post(f"/machines/m001/{path}")) == (403, "no_lease")
        assert machine.state is ThrowState.ARMED
        assert not machine.executed and not other.executed
        bob.delete("/machines/m002/lease")


def test_a_hold_at_another_machine_holds_nothing(running, machine, other, ada):
    machine.swing_s = 60.0
    for machine_id in ("m001", "m002"):
        assert ada.post(f"/machines/{machine_id}/lease").status_code == 200
    plan_id = make_plan(ada)
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
    throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
    with Hold(running.url, ada, "m002") as hold:
        hold.throw_id = throw_id
        assert ended(ada, throw_id)["outcome"] == "aborted"
        assert not any(reply["is_relayed"] for reply in hold.replies)
    assert not machine.heartbeats and not other.heartbeats


def test_taking_over_during_the_swing_lets_go(running, machine, ada):
    machine.swing_s = 60.0
    assert ada.post("/machines/m001/lease").status_code == 200
    plan_id = make_plan(ada)
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
    with Hold(running.url, ada) as hold, running.client("sue") as sue:
        throw_id = hold.throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
        wait_for(lambda: machine.heartbeats)
        body = {"reason": "a person walks in"}
        assert sue.post("/machines/m001/lease/take", json=body).status_code == 200
        assert ended(ada, throw_id)["outcome"] == "aborted"
        beat_count = len(machine.heartbeats)
        time.sleep(0.2)  # the old holder still sends: nothing of it may reach the machine
        assert len(machine.heartbeats) == beat_count
        sue.delete("/machines/m001/lease")
