import time

import pytest

from machine.messages import EventKind, RejectReason, ThrowState
from server.store.models import Audit
from tests.server.hold_client import Hold
from tests.server.server_bench import wait_for

PLAN = {"mode": "2d", "target": {"range_m": 6.03, "azimuth_rad": 0.02}, "rollout_count": 50}


@pytest.fixture
def plan_id(ada, machine):
    assert ada.post("/machines/m001/lease").status_code == 200
    return make_plan(ada)


def make_plan(client):
    plan = client.post("/machines/m001/plans", json=PLAN).json()
    wait_for(lambda: client.get(f"/plans/{plan['plan_id']}").json()["state"] != "previewing")
    plan = client.get(f"/plans/{plan['plan_id']}").json()
    assert plan["state"] == "ready", plan["refusals"]
    return plan["plan_id"]


def code(reply):
    return reply.status_code, reply.json()["error"]["code"]


def ended(client, throw_id):
    return wait_for(
        lambda: (
            row := client.get(f"/throws/{throw_id}").json()["row"],
            row if row["phase"] == "ended" else None,
        )[1],
    )


def throw_count(running):
    return running.parts.throws.count()


def audit_rows(running, action, **wanted):
    with running.parts.database.read() as database:
        query = database.query(Audit).filter_by(action=action, **wanted)
        return query.order_by(Audit.sequence_count).all()


def test_the_whole_way(running, machine, ada, plan_id):
    plan = ada.get(f"/plans/{plan_id}").json()
    armed = ada.post(f"/plans/{plan_id}/arm", json={"plan_hash": plan["plan_hash"]})
    assert armed.status_code == 200, armed.text
    assert armed.json()["plan_hash"] == machine.plan_hash == plan["plan_hash"]
    with Hold(running.url, ada) as hold:
        fired = ada.post(f"/plans/{plan_id}/fire").json()
        hold.throw_id = fired["throw_id"]
        assert fired["state"] == "accepted"
        row = ended(ada, fired["throw_id"])
    assert row["outcome"] == "landed"
    wait_for(lambda: ada.get(f"/throws/{fired['throw_id']}").json()["impacts"])
    detail = ada.get(f"/throws/{fired['throw_id']}").json()
    assert detail["row"]["measured_downrange_error_m"] == pytest.approx(0.12)
    assert detail["row"]["measured_crossrange_error_m"] == pytest.approx(-0.05)
    assert detail["row"]["predicted_downrange_error_m"] == pytest.approx(
        plan["prediction"]["downrange_error_m"]
    )
    assert [item["kind"] for item in detail["events"]][:2] == ["throw_accepted", "throw_started"]
    assert detail["plan"]["plan_id"] == plan_id
    assert not hold.replies[0]["is_relayed"]  # it had no time of the machine to echo
    seen_ns = hold.replies[1].pop("machine_t_mono_ns")
    assert seen_ns > hold.replies[0]["machine_t_mono_ns"]
    assert hold.replies[1] == {"throw_id": fired["throw_id"], "is_relayed": True, "detail": ""}
    beats = [beat for _, beat in machine.heartbeats]
    assert [beat.sequence_count for beat in beats] == list(range(1, len(beats) + 1))
    assert all(beat.seen_t_mono_ns is not None for beat in beats)
    for action in ("arm", "fire"):
        rows = [r for r in audit_rows(running, action) if r.phase in ("intent", "outcome")][-2:]
        assert [row.phase for row in rows] == ["intent", "outcome"]
        assert machine.nonce is None or machine.nonce not in "".join(r.detail_json for r in rows)


def test_a_plan_is_thrown_once(running, machine, ada, plan_id):
    machine.needs_hold = False
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
    throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
    assert code(ada.post(f"/plans/{plan_id}/fire")) == (409, "not_armed")
    ended(ada, throw_id)
    assert code(ada.post(f"/plans/{plan_id}/arm", json={})) == (409, "plan_used")
    assert machine.executed == [throw_id]


def test_nothing_happens_without_a_lease(running, machine, ada):
    before = throw_count(running)
    ada.delete("/machines/m001/lease")
    plan_id = make_plan(ada)
    assert code(ada.post(f"/plans/{plan_id}/arm", json={})) == (403, "no_lease")
    assert code(ada.post(f"/plans/{plan_id}/fire")) == (403, "no_lease")
    for path in ("load", "abort", "disarm"):
        assert code(ada.post(f"/machines/m001/{path}")) == (403, "no_lease")
    assert {command.kind for command in machine.commands} <= {"lease"}
    assert throw_count(running) == before


def test_another_operator_cannot_fire_what_one_armed(running, machine, ada, plan_id):
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
    with running.client("bob") as bob:
        assert code(bob.post("/machines/m001/lease")) == (409, "lease_held")
        assert code(bob.post(f"/plans/{plan_id}/fire")) == (403, "no_lease")
    assert not machine.executed


def test_taking_over_disarms(running, machine, ada, plan_id):
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
    with running.client("sue") as sue:
        taken = sue.post("/machines/m001/lease/take", json={"reason": "not paying attention"})
        assert taken.status_code == 200
        wait_for(lambda: machine.state is ThrowState.DISARMED)
        assert machine.epoch_count == taken.json()["epoch_count"]
        assert code(ada.post(f"/plans/{plan_id}/fire")) == (403, "no_lease")
        sue.delete("/machines/m001/lease")


def test_letting_go_aborts_before_the_commit_point(running, machine, ada, plan_id):
    machine.swing_s = 60.0
    ada.post(f"/plans/{plan_id}/arm", json={})
    with Hold(running.url, ada) as hold:
        hold.throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
        wait_for(lambda: machine.heartbeats)
        hold.silent = True
        row = ended(ada, hold.throw_id)
    assert row["outcome"] == "aborted"


def test_closing_the_browser_lets_go_at_once(running, machine, ada, plan_id):
    machine.swing_s = 60.0
    ada.post(f"/plans/{plan_id}/arm", json={})
    with Hold(running.url, ada) as hold:
        hold.throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
        wait_for(lambda: machine.heartbeats)
    assert ended(ada, hold.throw_id)["outcome"] == "aborted"
    assert not machine.heartbeats[-1][1].is_holding  # said so, not left to silence


def test_holds_of_others_do_not_count(running, machine, ada, plan_id):
    machine.swing_s = 1.0
    ada.post(f"/plans/{plan_id}/arm", json={})
    throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
    with running.client("bob") as bob, Hold(running.url, bob) as hold:
        hold.throw_id = throw_id
        wait_for(lambda: hold.replies)
        assert not hold.replies[0]["is_relayed"]
        assert ended(ada, throw_id)["outcome"] == "aborted"
    assert not machine.heartbeats


def test_another_plan_hash_than_shown_is_refused(machine, ada, plan_id):
    reply = ada.post(f"/plans/{plan_id}/arm", json={"plan_hash": "0" * 64})
    assert code(reply) == (409, "plan_mismatch")
    assert machine.state is ThrowState.DISARMED


def test_a_machine_that_moved_needs_a_new_preview(machine, ada, plan_id):
    joints = list(machine.joints)
    joints[1] += 0.1
    machine.joints = tuple(joints)
    wait_for(lambda: ada.get("/machines/m001").json()["state"]["joint_position_rad_m"] == joints)
    reply = ada.post(f"/plans/{plan_id}/arm", json={})
    assert code(reply) == (409, "machine_moved")
    assert "0.100" in reply.json()["error"]["message"]


def test_the_machines_refusal_reaches_the_operator(running, machine, ada, plan_id):
    machine.refuses["arm"] = RejectReason.CHECK_FAILED
    assert code(ada.post(f"/plans/{plan_id}/arm", json={})) == (409, "check_failed")
    assert code(ada.post(f"/plans/{plan_id}/fire")) == (409, "not_armed")
    machine.refuses.clear()
    ada.post(f"/plans/{plan_id}/arm", json={})
    machine.refuses["fire"] = RejectReason.NONCE_EXPIRED
    assert code(ada.post(f"/plans/{plan_id}/fire")) == (409, "nonce_expired")
    newest = ada.get("/throws", params={"limit": 1}).json()["rows"][0]
    assert (newest["phase"], newest["outcome"]) == ("ended", "refused")


def test_lost_answer_is_unknown_blocks_and_is_resolved_by_events(running, machine, ada, plan_id):
    next_plan = make_plan(ada)
    machine.needs_hold = False
    machine.keeps_events = True
    ada.post(f"/plans/{plan_id}/arm", json={})
    machine.drops_replies_of.add("fire")
    fired = ada.post(f"/plans/{plan_id}/fire").json()
    assert fired["state"] == "unknown"
    shown = ada.get("/machines/m001").json()
    assert shown["unknown_throw_id"] == fired["throw_id"]
    wait_for(lambda: machine.state is ThrowState.DISARMED)
    time.sleep(2.5)  # idle, but its outbox still has something to tell: it stays blocked
    assert code(ada.post(f"/plans/{next_plan}/arm", json={})) == (409, "unknown_outcome")
    machine.keeps_events = False
    assert ended(ada, fired["throw_id"])["outcome"] == "landed"
    assert ada.get("/machines/m001").json()["unknown_throw_id"] is None
    assert machine.executed == [fired["throw_id"]]
    assert [c.kind for c in machine.commands].count("fire") == 1


def test_a_fire_that_never_arrived_is_resolved_as_not_executed(running, machine, ada, plan_id):
    ada.post(f"/plans/{plan_id}/arm", json={})
    machine.ignores.add("fire")
    fired = ada.post(f"/plans/{plan_id}/fire").json()
    assert fired["state"] == "unknown"
    time.sleep(1.0)  # still armed: a late fire could still be executed
    assert ada.get(f"/throws/{fired['throw_id']}").json()["row"]["phase"] == "unknown"
    with machine._lock:
        machine._disarm()
    assert ended(ada, fired["throw_id"])["outcome"] == "not_executed"
    assert [c.kind for c in machine.commands].count("fire") == 1


def test_if_the_audit_cannot_be_written_nothing_is_sent(
    running, machine, ada, plan_id, monkeypatch
):
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
    before, sent = throw_count(running), len(machine.commands)

    def fail(*_args, **_kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(running.parts.audit, "append", fail)
    assert code(ada.post(f"/plans/{plan_id}/fire")) == (503, "audit_failed")
    assert code(ada.post("/machines/m001/disarm")) == (503, "audit_failed")
    monkeypatch.undo()
    assert len(machine.commands) == sent
    assert throw_count(running) == before


def test_intent_is_on_disk_when_the_command_arrives(running, machine, ada, plan_id, monkeypatch):
    seen = []
    send = running.parts.link.send

    def spy(command):
        with running.parts.database.read() as database:
            last = database.query(Audit).order_by(Audit.sequence_count.desc()).first()
            seen.append((command.kind, last.action, last.phase))
        return send(command)

    monkeypatch.setattr(running.parts.link, "send", spy)
    machine.needs_hold = False
    ada.post(f"/plans/{plan_id}/arm", json={})
    throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
    ended(ada, throw_id)
    ada.post("/machines/m001/load")
    assert [item for item in seen if item[0] != "lease"] == [
        ("arm", "arm", "intent"),
        ("fire", "fire", "intent"),
        ("load", "load", "intent"),
    ]


def test_stale_epochs_are_refused_by_the_machine(running, machine, ada, plan_id):
    with machine._lock:
        machine.epoch_count = 1_000_000
    reply = ada.post(f"/plans/{plan_id}/arm", json={})
    assert code(reply) == (409, "stale_epoch")
    # A fresh lease starts above what the machine remembers.
    wait_for(lambda: ada.get("/machines/m001").json()["state"]["epoch_count"] == 1_000_000)
    ada.delete("/machines/m001/lease")
    assert ada.post("/machines/m001/lease").json()["epoch_count"] > 1_000_000
    assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200


def test_events_of_the_throw_carry_its_story_once(running, machine, ada, plan_id):
    machine.needs_hold = False
    ada.post(f"/plans/{plan_id}/arm", json={})
    throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
    ended(ada, throw_id)
    wait_for(lambda: not machine._outbox)
    kinds = [item["kind"] for item in ada.get(f"/throws/{throw_id}").json()["events"]]
    assert kinds == [
        kind.value
        for kind in (
            EventKind.THROW_ACCEPTED,
            EventKind.THROW_STARTED,
            EventKind.RELEASE_COMMANDED,
            EventKind.IMPACT,
            EventKind.THROW_ENDED,
        )
    ]
