"""Documents have the shape of ISO/TS 15143-3:2016: names, order, namespace, links."""

from datetime import timedelta
from xml.etree import ElementTree

import pytest
from pydantic import SecretStr
from starlette.requests import Request

from server.clock import id_at, utc_now
from server.dependencies import admit_reader
from server.errors import ApiError, NotFoundError, NotSignedInError
from server.schemas.console import Permission
from server.telematics import documents, equipment
from server.telematics.documents import NAMESPACE, as_json, as_xml, links
from server.telematics.equipment import FleetTelematics
from tests.server.fake_machine import FakeMachine
from tests.server.fleet.test_machine_summaries import add_throws

HEADER = ["UnitInstallDateTime", "OEMName", "Model", "EquipmentID", "SerialNumber"]
MACHINE = ("Menzi Muck", "M545", "m001")


def local(element):
    namespace, _, name = element.tag[1:].partition("}")
    assert namespace == NAMESPACE
    return name


def listed(parts, *ids):
    for machine_id in ids:
        parts.registry.get(machine_id).is_listed = True
    return FleetTelematics(parts.database, parts.registry, "/base")


def state_with_hours(operating_s, idle_s):
    machine = FakeMachine("tcp/127.0.0.1:1", "m001", "", {})
    hours = {"operating_s": operating_s, "idle_s": idle_s}
    return machine.state_message().model_copy(update=hours)


def test_a_snapshot_has_the_standards_names_in_their_order(assembled):
    fleet = listed(assembled.parts, "m001", "m002")
    add_throws(assembled.parts, 3, 0.1)
    add_throws(assembled.parts, 2, 0.1, outcome="aborted")
    root = ElementTree.fromstring(as_xml("Fleet", fleet.fleet(1)))
    assert local(root) == "Fleet"
    assert set(root.attrib) == {"version", "snapshotTime"}
    links_of = [
        {local(item): item.text for item in link} for link in root if local(link) == "Links"
    ]
    assert {link["rel"]: link["href"] for link in links_of} == dict.fromkeys(
        ("self", "first", "last"), "/base/Fleet/1"
    )
    first, second = (item for item in root if local(item) == "Equipment")
    assert [local(item) for item in first] == ["EquipmentHeader", "CumulativeLoadCount"]
    assert [local(item) for item in first[0]] == HEADER
    assert first[0][4].text == "m001"
    assert list(first[1].attrib) == ["datetime"] and first[1].attrib["datetime"].endswith("Z")
    assert [(local(item), item.text) for item in first[1]] == [("Count", "3")]
    assert [local(item) for item in second] == ["EquipmentHeader"], "nothing thrown, nothing said"
    single = ElementTree.fromstring(as_xml("Equipment", fleet.single(*MACHINE)))
    assert [local(item) for item in single] == ["EquipmentHeader", "CumulativeLoadCount"]
    known = assembled.parts.registry.get("m001")
    known.state, known.last_seen_utc = state_with_hours(7200.0, 1800.0), utc_now()
    counted = ElementTree.fromstring(as_xml("Equipment", fleet.single(*MACHINE)))
    assert [local(item) for item in counted] == [
        "EquipmentHeader",
        "CumulativeIdleHours",
        "CumulativeLoadCount",
        "CumulativeOperatingHours",
    ]
    assert [item[0].text for item in counted[1:]] == ["0.5", "3", "2.0"]
    with pytest.raises(NotFoundError):
        fleet.fleet(2)
    with pytest.raises(NotFoundError):
        fleet.single("Menzi Muck", "M545", "m099")
    with pytest.raises(NotFoundError):
        fleet.single("Somebody", "M545", "m001")


def test_loads_are_counted_over_time_and_in_pages(assembled, monkeypatch):
    for module in (documents, equipment):
        monkeypatch.setattr(module, "PAGE_COUNT", 2)
    fleet = listed(assembled.parts, "m001", "m002")
    now = utc_now().replace(microsecond=0)
    times = [now - timedelta(hours=hours) for hours in (9, 5, 4, 3)]
    for at in times:
        add_throws(assembled.parts, 1, 0.1, throw_id=id_at(at), created_utc=at)
    period = (now - timedelta(hours=6), now)
    series = fleet.load_counts(MACHINE, period, 1)
    assert [row["Count"] for row in series["CumulativeLoadCount"]] == [2, 3]
    assert series["CumulativeLoadCount"][0]["datetime"] == times[1].strftime("%Y-%m-%dT%H:%M:%SZ")
    following = {link["rel"]: link["href"] for link in series["Links"]}["next"]
    assert following.startswith("/base/Fleet/Equipment/MakeModelSerial/Menzi%20Muck/M545/m001/")
    assert following.endswith("Z/2")
    last = fleet.load_counts(MACHINE, period, 2)
    assert [row["Count"] for row in last["CumulativeLoadCount"]] == [4]
    assert fleet.load_counts(("Menzi Muck", "m545", "m002"), period, 1)["CumulativeLoadCount"] == []
    with pytest.raises(ApiError, match="before it begins"):
        fleet.load_counts(MACHINE, period[::-1], 1)
    assert len(fleet.fleet(1)["Equipment"]) == 2


def test_links_of_a_page_in_the_middle():
    found = {link["rel"]: link["href"] for link in links("/Fleet", 2, 3)}
    assert found == {
        "self": "/Fleet/2",
        "first": "/Fleet/1",
        "prev": "/Fleet/1",
        "next": "/Fleet/3",
        "last": "/Fleet/3",
    }


def test_json_has_the_same_fields_without_the_root():
    document = {"@version": 1, "Links": [{"rel": "self"}], "Load": {"datetime": "t", "Count": 1}}
    assert as_json(document) == (
        b'{"version":1,"Links":[{"rel":"self"}],"Load":{"datetime":"t","Count":1}}'
    )


def test_a_token_or_a_session_reads_and_nobody_else(running, ada):
    path = "/telematics/Fleet/1"
    reply = ada.get(path)
    assert (reply.status_code, reply.headers["content-type"]) == (200, "application/xml")
    reply = ada.get(path, headers={"Accept": "application/json"})
    assert reply.headers["content-type"] == "application/json"
    assert reply.json()["Links"][0]["href"] == f"/api/v1{path}"
    with running.client() as nobody:
        assert nobody.get(path).status_code == 401
        # Without a token in the settings no token is the right one.
        reply = nobody.get(path, headers={"Authorization": "Bearer guess"})
        assert reply.json()["error"]["code"] == "wrong_token"


def test_the_right_token_is_enough(running):
    def admit(text: bytes):
        request = Request({"type": "http", "headers": [(b"authorization", text)]})
        admit_reader(request, running.parts.access, SecretStr("right"), "NAME", Permission.VIEW)

    admit(b"Bearer right")
    for wrong in (b"Bearer wrong", b"Bearer ", b"Bearer right "):
        with pytest.raises(NotSignedInError, match="NAME"):
            admit(wrong)
