import json
import os
import signal

import pytest

from machine.messages import RejectReason
from server.machines.twin_files import TwinFiles
from server.plans.preview_pool import PreviewPool
from server.plans.preview_worker import PreviewJob, _warm_up_job, unit_of
from sim_twin.twin.profile import nominal_profile, save_profile
from tests.cases import each
from tests.server.server_bench import wait_for
from tests.server.test_events import Listener

NEAR = {"range_m": 6.03, "azimuth_rad": 0.02}


def create(client, target=NEAR, mode="2d", rollout_count=0):
    reply = client.post(
        "/machines/m001/plans",
        json={"mode": mode, "target": target, "rollout_count": rollout_count},
    )
    assert reply.status_code == 201, reply.text
    return reply.json()


def finished(client, plan):
    path = f"/plans/{plan['plan_id']}"
    wait_for(lambda: client.get(path).json()["is_complete"], 120.0)
    return client.get(path).json()


def test_a_plan_has_numbers_path_frames_and_a_hash(machine, ada):
    plan = finished(ada, create(ada))
    assert plan["state"] == "ready"
    prediction = plan["prediction"]
    assert abs(prediction["downrange_error_m"]) < 0.5
    assert prediction["flight_s"] > 0.0
    names = {item["name"]: item for item in prediction["clearances"]}
    assert names["gripper to ground"]["value_m"] > 0.0
    assert names["boom to its limit"]["value_rad"] is not None
    assert len(plan["plan_hash"]) == 64
    assert plan["pace_ratio"] == 0.0
    frames = ada.get(f"/plans/{plan['plan_id']}/frames").json()
    assert frames["frame_period_s"] == pytest.approx(0.02)
    assert frames["frames_rad_m"][0][1] == pytest.approx(machine.joints[1], abs=1e-3)
    assert len(frames["ball_path_m"]) > 5


def test_a_plan_keeps_its_pace_and_refuses_one_that_is_none(machine, ada):
    body = {"mode": "2d", "target": {"x_m": 8.0, "y_m": 0.0}, "rollout_count": 0}
    path = "/machines/m001/plans"
    assert ada.post(path, json={**body, "pace_ratio": 1.5}).status_code == 422
    plan = ada.post(path, json={**body, "pace_ratio": 0.75}).json()
    assert plan["pace_ratio"] == 0.75
    assert finished(ada, plan)["plan_hash"] != finished(ada, create(ada))["plan_hash"]


def test_the_ellipse_arrives_by_events_of_this_session_only(running, machine, ada):
    with running.client("bob") as bob, Listener(ada) as mine, Listener(bob) as other:
        plan = create(ada, rollout_count=60)
        wait_for(lambda: any(e["plan"]["is_complete"] for e in mine.of("plan.updated")), 120.0)
        updates = [e["plan"] for e in mine.of("plan.updated")]
        assert {u["plan_id"] for u in updates} == {plan["plan_id"]}
        assert updates[0]["prediction"]["ellipse"] is None
        ellipse = updates[-1]["prediction"]["ellipse"]
        assert ellipse["rollout_count"] == 60
        assert updates[0]["plan_hash"] != updates[-1]["plan_hash"]
        assert not other.of("plan.updated")
        # Any version that was shown may be armed, and it is that version that is armed.
        ada.post("/machines/m001/lease")
        shown = updates[0]["plan_hash"]
        armed = ada.post(f"/plans/{plan['plan_id']}/arm", json={"plan_hash": shown})
        assert armed.json()["plan_hash"] == shown == machine.plan_hash
        assert ada.get(f"/plans/{plan['plan_id']}").json()["plan_hash"] == shown


@each(
    ("target", "reason", "number"),
    [
        ({"x_m": 11.4, "y_m": 0.0}, "target_out_of_reach", "11.40 m"),
        ({"x_m": 2.0, "y_m": 0.0}, "target_too_near", "2.00 m"),
        ({"x_m": 0.0, "y_m": 0.0}, "target_too_near", "0.00 m"),
        ({"x_m": 8.0, "y_m": 0.0, "z_m": 3.0}, "target_out_of_reach", "+3.00 m"),
        ({"x_m": 10.5, "y_m": 0.0}, "preview_refused", "predicted miss"),
    ],
)
def test_refusals_have_a_reason_and_the_numbers(machine, ada, target, reason, number):
    plan = finished(ada, create(ada, target))
    assert plan["state"] == "refused"
    assert plan["refusals"][0]["reason"] == reason
    assert number in plan["refusals"][0]["detail"]
    assert plan["plan_hash"] is None
    ada.post("/machines/m001/lease")
    reply = ada.post(f"/plans/{plan['plan_id']}/arm", json={})
    assert (reply.status_code, reply.json()["error"]["code"]) == (409, reason)


def test_a_plan_whose_spread_was_not_checked_is_to_look_at_only(machine, ada):
    ada.post("/machines/m001/lease")
    for rollout_count, words in ((0, "with 0 throws"), (6, "with 6 throws")):
        plan = finished(ada, create(ada, rollout_count=rollout_count))
        assert plan["state"] == "ready"
        reply = ada.post(f"/plans/{plan['plan_id']}/arm", json={})
        assert (reply.status_code, reply.json()["error"]["code"]) == (409, "preview_incomplete")
        assert words in reply.json()["error"]["message"]
    assert machine.nonce is None


def test_an_empty_gripper_is_previewed_as_if_loaded(machine, ada):
    machine.payload_held = False
    wait_for(lambda: not ada.get("/machines/m001").json()["state"]["payload_held"])
    plan = finished(ada, create(ada, rollout_count=20))
    assert plan["state"] == "ready"
    assert plan["prediction"]["ellipse"] is not None


def test_another_policy_aboard_is_refused(machine, ada):
    machine._policies = {"2d": "c" * 64}
    wait_for(lambda: ada.get("/machines/m001").json()["state"]["policy_sha256"] == {"2d": "c" * 64})
    plan = create(ada)
    assert plan["refusals"][0]["reason"] == RejectReason.POLICY_MISMATCH
    detail = plan["refusals"][0]["detail"]
    assert "m001 has policy cccccccccccc for 2d on board" in detail
    active = next(p for p in ada.get("/policies").json() if p["is_active"] and p["mode"] == "2d")
    assert f"{active['policy_id']} ({active['policy_sha256'][:12]})" in detail
    assert "page Policies" in detail


def test_a_machine_is_previewed_with_the_version_that_it_has(running, machine, ada):
    """Another usable version is on board, not the active one: the plan is of that one."""
    folder = running.settings.policies_dir
    active = folder / "active.json"
    text = active.read_text()
    policies = running.parts.policies
    aboard = policies.active("2d").card
    assert machine._policies["2d"] == aboard.policy_sha256
    try:
        active.write_text(json.dumps({"3d": "swing-3d"}))
        policies._looked_s = -1e9
        plan = create(ada)
        assert plan["policy_sha256"] == aboard.policy_sha256
        assert plan["refusals"] == []
    finally:
        active.write_text(text)
        policies._looked_s = -1e9


def test_a_lost_machine_cannot_be_previewed(running, ada):
    wait_for(lambda: not running.parts.registry.is_connected("m001"))
    reply = ada.post(
        "/machines/m001/plans", json={"mode": "2d", "target": NEAR, "rollout_count": 0}
    )
    assert (reply.status_code, reply.json()["error"]["code"]) == (503, "machine_lost")


def test_without_a_usable_policy_the_cause_is_reported(running, machine, ada):
    machine._policies = {"2d": "c" * 64}
    wait_for(lambda: ada.get("/machines/m001").json()["state"]["policy_sha256"] == {"2d": "c" * 64})
    policies = running.parts.policies
    active = running.settings.policies_dir / "active.json"
    text = active.read_text()
    try:
        active.write_text('{"2d": "gone"}')
        policies._looked_s = -1e9
        body = {"mode": "2d", "target": NEAR, "rollout_count": 0}
        reply = ada.post("/machines/m001/plans", json=body)
        assert (reply.status_code, reply.json()["error"]["code"]) == (409, "policy_unusable")
        assert "gone" in reply.json()["error"]["message"]
        assert ada.get("/machines/m001").json()["reach"]["modes"] == []
    finally:
        active.write_text(text)
        policies._looked_s = -1e9


def test_an_expired_plan_cannot_be_armed(running, machine, ada):
    from datetime import timedelta

    ada.post("/machines/m001/lease")
    plan = finished(ada, create(ada))
    row = running.parts.plans.row(plan["plan_id"])
    row.expires_utc = row.created_utc - timedelta(seconds=1)
    reply = ada.post(f"/plans/{plan['plan_id']}/arm", json={})
    assert (reply.status_code, reply.json()["error"]["code"]) == (409, "plan_expired")


def test_an_incomplete_plan_cannot_be_armed_and_a_newer_preview_stops_it(machine, ada):
    ada.post("/machines/m001/lease")
    older = create(ada, rollout_count=1000)
    path = f"/plans/{older['plan_id']}"
    # It has a hash as soon as its nominal throw is known, but the spread of its landings is not checked.
    plan_hash = wait_for(lambda: ada.get(path).json()["plan_hash"])
    early = ada.post(f"{path}/arm", json={"plan_hash": plan_hash})
    assert (early.status_code, early.json()["error"]["code"]) == (409, "preview_incomplete")
    assert "not complete" in early.json()["error"]["message"]
    newer = finished(ada, create(ada))
    wait_for(lambda: ada.get(path).json()["state"] in ("failed", "previewing"))
    assert not ada.get(path).json()["is_complete"]
    assert newer["state"] == "ready"


@pytest.fixture(scope="module")
def pool():
    pool = PreviewPool(1, ())
    pool.start()
    yield pool
    pool.close()


def job(swing_policies, job_id, rollout_count=0) -> PreviewJob:
    from dataclasses import replace

    from machine.spec import load_spec

    warm = _warm_up_job(swing_policies / "swing-2d", load_spec())
    return replace(warm, job_id=job_id, rollout_count=rollout_count)


def test_a_process_that_dies_costs_only_its_own_preview(pool, swing_policies):
    first = pool.submit(job(swing_policies, "a"), lambda _: None)
    assert first.result(120.0).impact_m is not None
    doomed = pool.submit(job(swing_policies, "b", 1000), lambda _: None)
    wait_for(doomed.running)
    for pid in list(pool._pool._processes):
        os.kill(pid, signal.SIGKILL)
    with pytest.raises(Exception, match="terminated abruptly"):
        doomed.result(60.0)
    updates = []
    again = pool.submit(job(swing_policies, "c", 4), updates.append)
    assert again.result(120.0).ellipse.rollout_count == 4
    wait_for(lambda: updates)


def test_profiles_and_calibrations_are_files_of_the_machine(tmp_path):
    from machine.spec import load_spec

    files = TwinFiles(tmp_path)
    assert (files.profile_path("m001"), files.profile_version("m001")) == (None, 0)
    (tmp_path / "machines").mkdir()
    profile = nominal_profile(load_spec()).model_copy(update={"version_count": 3})
    save_profile(profile, tmp_path / "machines" / "m001.profile.json")
    assert files.profile_version("m001") == 3
    assert files.calibration_path("m001") is None


def test_units_of_clearances():
    assert unit_of("boom to its limit") == unit_of("dipper to its limit") == "rad"
    assert unit_of("telescope to its limit") == unit_of("gripper to cabin") == "m"
