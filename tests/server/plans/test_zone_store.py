"""Exclusion zones on the server: versions, approval, what plans and the machine learn of them."""

import pytest

from machine.site.zones import Zone, zones_sha256
from server.composition import _needs_two
from server.schemas.console import Role
from server.store.models import User, ZoneVersion
from tests.server.plans.test_planner import NEAR, create, finished
from tests.server.server_bench import PASSWORD, add_people, make_settings, running_server
from tests.server.test_events import Listener
from tests.waiting import wait_for

PATH = "/machines/m001/zones"
OFFICE = {
    "name": "Office",
    "reason": "people work there",
    "corners_m": [[5.0, -1.0], [7.0, -1.0], [7.0, 1.0], [5.0, 1.0]],
    "bottom_m": 0.0,
    "top_m": 3.0,
}
FAR = OFFICE | {"name": "Shed", "corners_m": [[20.0, 20.0], [22.0, 20.0], [21.0, 23.0]]}


def change(client, zones, reason="the plan of the yard"):
    version = client.get(PATH).json()["version_count"]
    return client.put(PATH, json={"zones": zones, "from_version_count": version, "reason": reason})


def approve(client, version=None):
    version = client.get(PATH).json()["version_count"] if version is None else version
    return client.post(f"{PATH}/approve", json={"version_count": version})


@pytest.fixture
def sue(running):
    """A supervisor; leaves no zones."""
    with running.client("sue") as client:
        yield client
        if client.get(PATH).json()["approved"]:
            with running.client("ada") as ada:
                change(ada, [])
            assert approve(client).status_code == 200


def on_board(running, sha256):
    wait_for(lambda: running.parts.registry.get("m001").state.zones_sha256 == sha256)


def test_a_draft_is_in_force_once_a_supervisor_approves_it(running, ada, sue):
    first = ada.get(PATH).json()["version_count"]
    draft = change(ada, [OFFICE]).json()
    assert (draft["version_count"], draft["changed_by"]) == (first + 1, "ada")
    assert (draft["is_approved"], draft["approved"], draft["approved_sha256"]) == (False, [], "")
    assert approve(ada).status_code == 403
    stale = approve(sue, first)
    assert (stale.status_code, stale.json()["error"]["code"]) == (409, "zones_changed")
    active = approve(sue).json()
    assert (active["is_approved"], active["approved_by"]) == (True, "sue")
    assert active["approved_sha256"] == zones_sha256((Zone.model_validate(OFFICE),))
    again = approve(sue)
    assert (again.status_code, again.json()["error"]["code"]) == (409, "zones_approved")
    # A change leaves what is approved in force; undo goes back to it, and needs no approval then.
    moved = change(ada, [OFFICE | {"top_m": 4.0}], "it has another floor").json()
    assert (moved["is_approved"], moved["approved"][0]["top_m"]) == (False, 3.0)
    back = ada.post(f"{PATH}/undo").json()
    assert (back["is_approved"], back["zones"][0]["top_m"]) == (True, 3.0)
    listed = ada.get(f"{PATH}/versions").json()
    kept = [(v["created_by"], v["reason"], v["approved_by"]) for v in listed[:3]]
    assert kept == [
        ("ada", f"undo of version {first + 2}", None),
        ("ada", "it has another floor", None),
        ("ada", "the plan of the yard", "sue"),
    ]
    rows = sue.get("/audit").json()["rows"]
    made = [row for row in rows if row["phase"] == "fact"]
    actions = [row["action"] for row in made if row["action"].startswith("zones.")]
    assert actions[:4] == ["zones.undo", "zones.edit", "zones.approve", "zones.edit"]


def test_whoever_had_a_hand_in_a_draft_does_not_approve_it(running, ada, sue):
    """Also not through a later version of another person that keeps what they drew."""
    assert change(sue, [OFFICE]).json()["drawn_by"] == ["sue"]
    own = approve(sue)
    assert (own.status_code, own.json()["error"]["code"]) == (409, "four_eyes")
    moved = change(ada, [OFFICE | {"top_m": 3.5}]).json()
    assert (moved["drawn_by"], moved["is_four_eyes"]) == (["ada", "sue"], True)
    assert approve(sue).status_code == 409
    with running.client("eve") as eve:
        assert approve(eve).json()["approved_by"] == "eve"
    # What has been taken back to the approved zones has no part in a later draft.
    change(sue, [FAR])
    assert sue.post(f"{PATH}/undo").json()["drawn_by"] == []
    assert change(ada, [FAR]).json()["drawn_by"] == ["ada"]
    assert approve(sue).status_code == 200


def test_where_one_account_may_approve_it_approves_its_own_zones(assembled):
    parts = assembled.parts
    settings = parts.settings.model_copy(update={"zones_four_eyes": True})
    parts.accounts.create_user("sue", PASSWORD, Role.SUPERVISOR)
    assert not _needs_two(parts.settings, parts.accounts) and _needs_two(settings, parts.accounts)
    parts.accounts.create_user("eve", PASSWORD, Role.ENGINEER)
    assert _needs_two(parts.settings, parts.accounts)
    with parts.database.write() as database:
        database.get(User, "eve").is_disabled = True
    assert not _needs_two(parts.settings, parts.accounts)


def test_what_is_no_zone_is_refused_in_words(ada, sue):
    crossed = OFFICE | {"corners_m": [[0, 0], [2, 2], [2, 0], [0, 2]]}
    for zones, words in (
        ([crossed], "crosses or touches"),
        ([OFFICE, OFFICE], "two zones are named"),
        ([OFFICE | {"top_m": 0.0}], "above its bottom"),
    ):
        reply = change(ada, zones)
        assert reply.status_code == 422
        assert words in reply.json()["error"]["message"]
    late = ada.put(PATH, json={"zones": [], "from_version_count": 999, "reason": "because"})
    assert (late.status_code, late.json()["error"]["code"]) == (409, "zones_changed")
    assert ada.put(PATH, json={"zones": [], "from_version_count": 0}).status_code == 422


def test_viewers_may_look_only(running):
    with running.client("vic") as vic:
        assert change(vic, []).status_code == 403
        assert approve(vic, 1).status_code == 403
        assert vic.get(f"{PATH}/versions").status_code == 200


def test_an_approved_set_is_sent_and_binds_plans(running, machine, ada, sue):
    before = finished(ada, create(ada, rollout_count=50))
    assert before["state"] == "ready"
    change(ada, [FAR])
    with Listener(ada) as mine:
        approve(sue)
        wait_for(lambda: mine.of("zones.updated"))
    sha256 = sue.get(PATH).json()["approved_sha256"]
    on_board(running, sha256)
    ada.post("/machines/m001/lease")
    stale = ada.post(f"/plans/{before['plan_id']}/arm", json={})
    assert (stale.status_code, stale.json()["error"]["code"]) == (409, "zones_mismatch")
    plan = finished(ada, create(ada, rollout_count=50))
    assert plan["state"] == "ready", plan["refusals"]
    names = [item["name"] for item in plan["prediction"]["clearances"]]
    assert "arm or gripper to zone Shed" in names
    armed = ada.post(f"/plans/{plan['plan_id']}/arm", json={})
    assert armed.status_code == 200, armed.text
    sent = [c for c in machine.commands if c.kind == "arm"][-1].plan
    assert sent.zones_sha256 == sha256


def test_a_click_and_a_plan_into_a_zone_are_refused(running, machine, ada, sue):
    change(ada, [OFFICE])
    approve(sue)
    on_board(running, sue.get(PATH).json()["approved_sha256"])
    with Listener(ada) as mine:
        ada.put("/machines/m001/target", json=NEAR)
        wait_for(lambda: mine.of("target.proposed"))
        assert "into zone 'Office'" in mine.of("target.proposed")[-1]["refusal"]
    plan = finished(ada, create(ada))
    assert plan["refusals"][0]["reason"] == "target_in_zone"
    assert "kept free up to 3.0 m" in plan["refusals"][0]["detail"]


def test_a_machine_with_other_zones_is_sent_them_and_not_planned_for(running, machine, ada, sue):
    change(ada, [FAR])
    machine.ignores.add("zones")
    approve(sue)
    plan = finished(ada, create(ada))
    assert plan["refusals"][0]["reason"] == "zones_mismatch"
    machine.ignores.clear()
    on_board(running, sue.get(PATH).json()["approved_sha256"])
    # As after a restart with records that cannot be read.
    machine.zones_sha256 = None
    on_board(running, sue.get(PATH).json()["approved_sha256"])


def test_zones_outlive_a_restart_of_the_server(tmp_path, swing_policies):
    settings = make_settings(tmp_path / "data", swing_policies)
    with running_server(settings) as first:
        add_people(first.parts)
        with first.client("ada") as ada, first.client("sue") as sue:
            change(ada, [FAR])
            sha256 = approve(sue).json()["approved_sha256"]
    with running_server(settings) as second, second.machine() as machine:
        assert second.parts.zones.approved("m001").sha256 == sha256
        wait_for(lambda: machine.zones_sha256 == sha256)
        with second.parts.database.read() as database:
            row = database.get(ZoneVersion, ("m001", 1))
        assert (row.created_by, row.approved_by) == ("ada", "sue")


def test_the_zone_that_is_drawn_is_shown(running, machine, ada):
    session_id = ada.get("/auth/me").json()["session_id"]
    sketch = {"corners_m": [[5.0, 1.0], [6.0, 1.0]], "bottom_m": 0.5, "top_m": 2.0}
    assert ada.put("/view", json={"machine_id": "m001", "sketch": sketch}).status_code == 204
    stage = running.parts.scene._stage
    wait_for(lambda: stage.session(session_id) and stage.session(session_id).sketch.corners_m)
    assert stage.session(session_id).sketch == (((5.0, 1.0), (6.0, 1.0)), 0.5, 2.0)
    ada.put("/view", json={"sketch": {"corners_m": []}})
    wait_for(lambda: not stage.session(session_id).sketch.corners_m)
