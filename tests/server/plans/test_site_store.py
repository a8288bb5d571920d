import json

import pytest

from server.plans.site_store import dump
from tests.server.plans.test_planner import NEAR, create, finished
from tests.server.server_bench import wait_for
from tests.server.test_events import Listener

BED = {
    "name": "bed",
    "kind": "box",
    "x_m": 5.9,
    "y_m": 0.0,
    "length_m": 1.6,
    "width_m": 3.0,
    "height_m": 0.4,
}
PATH = "/machines/m001/site"


@pytest.fixture
def site(running):
    """Leaves the site as empty as it was."""
    yield running.parts.sites
    with running.client("ada") as client:
        version = client.get(PATH).json()["version_count"]
        put(client, [], version)


def put(client, objects, version):
    return client.put(PATH, json={"objects": objects, "from_version_count": version})


def test_a_site_has_versions_an_undo_and_audit_rows(running, ada, site):
    first = ada.get(PATH).json()["version_count"]
    assert ada.get(PATH).json()["objects"] == []
    one = put(ada, [BED], first).json()
    assert (one["version_count"], one["changed_by"]) == (first + 1, "ada")
    assert one["objects"][0]["turn_rad"] == 0.0
    two = put(ada, [BED, BED | {"name": "other", "x_m": 12.0}], first + 1).json()
    assert two["undo_version_count"] == first + 1
    # Somebody who still looks at the first version has to look again.
    late = put(ada, [], first + 1)
    assert (late.status_code, late.json()["error"]["code"]) == (409, "site_changed")
    back = ada.post(f"{PATH}/undo").json()
    assert [item["name"] for item in back["objects"]] == ["bed"]
    assert (back["version_count"], back["undo_version_count"]) == (first + 3, first)
    empty = ada.post(f"{PATH}/undo").json()
    assert empty["objects"] == []
    with running.client("sue") as sue:
        rows = sue.get("/audit").json()["rows"]
    actions = [row["action"] for row in rows if row["action"].startswith("site.")]
    assert sorted(actions[:4]) == ["site.edit", "site.edit", "site.undo", "site.undo"]


def test_what_cannot_stand_there_is_refused_in_words(ada, site):
    version = ada.get(PATH).json()["version_count"]
    reply = put(ada, [BED | {"x_m": 1.0}], version)
    assert reply.status_code == 422
    assert "the machine turns there" in reply.json()["error"]["message"]
    assert "Value error" not in reply.json()["error"]["message"]
    with_two = put(ada, [BED, BED], version)
    assert "two objects are named" in with_two.json()["error"]["message"]


def test_viewers_may_look_only(running, site):
    with running.client("vic") as vic:
        version = vic.get(PATH).json()["version_count"]
        assert put(vic, [], version).status_code == 403


def test_a_preview_lands_on_the_bed_and_a_changed_site_needs_a_new_one(machine, ada, site):
    version = ada.get(PATH).json()["version_count"]
    with Listener(ada) as mine:
        put(ada, [BED], version)
        wait_for(lambda: mine.of("site.updated"))
        assert mine.of("site.updated")[-1]["site"]["objects"][0]["name"] == "bed"
    plan = finished(ada, create(ada, NEAR | {"z_m": 0.4}, rollout_count=50))
    assert plan["state"] == "ready", plan["refusals"]
    prediction = plan["prediction"]
    assert (prediction["lands_on"], prediction["impact_m"][2]) == ("bed", pytest.approx(0.4))
    ada.post("/machines/m001/lease")
    put(ada, [BED | {"height_m": 0.5}], version + 1)
    stale = ada.post(f"/plans/{plan['plan_id']}/arm", json={"plan_hash": plan["plan_hash"]})
    assert (stale.status_code, stale.json()["error"]["code"]) == (409, "site_changed")
    assert "was changed since the preview" in stale.json()["error"]["message"]
    ada.post(f"{PATH}/undo")
    armed = ada.post(f"/plans/{plan['plan_id']}/arm", json={"plan_hash": plan["plan_hash"]})
    assert armed.status_code == 200, armed.text


def test_a_file_describes_the_site_until_a_person_does(assembled, caplog):
    folder = assembled.parts.settings.data_dir / "machines"
    (folder / "m001.site.json").write_text(json.dumps([BED]), encoding="utf-8")
    (folder / "m002.site.json").write_text(json.dumps([{"name": "what"}]), encoding="utf-8")
    sites = assembled.parts.sites
    sites.start()
    sites.start()
    view = sites.view("m001")
    assert (view.version_count, view.changed_by) == (1, "server")
    assert dump(view.objects)[0]["x_m"] == 5.9
    assert view.undo_version_count is None
    assert sites.view("m002").version_count == 0
    assert "m002.site.json is not used" in caplog.text
