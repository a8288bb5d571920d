import bisect
import random
from datetime import UTC, datetime, timedelta

import pytest

from machine.conventions import Mode
from machine.messages import EventBatch, EventKind, MachineEvent
from server.deployments.machine_policies import machines_that_need, rollback_of
from server.errors import NotFoundError
from server.store.models import Deployment, MachinePolicy
from tests.cases import each
from tests.server.store.test_database import machine

START = datetime(2026, 3, 1, 6, 0, tzinfo=UTC)
VERSIONS = ("a" * 64, "b" * 64, "c" * 64)


@pytest.fixture
def ingest(assembled):
    from server.throws.event_ingest import EventIngest

    parts = assembled.parts
    name_of = parts.policies.name_of
    found = EventIngest(parts.database, parts.throws, parts.hub, parts.metrics, name_of)
    found.on_store.append(parts.machine_policies.record)
    return found


def booted(machine_id, sequence, time, aboard, boot="b"):
    return MachineEvent(
        machine_id=machine_id,
        boot_id=boot,
        sequence_count=sequence,
        t_mono_ns=sequence * 1000,
        t_utc=time.isoformat(timespec="milliseconds"),
        kind=EventKind.BOOTED,
        data={"policy_sha256": aboard},
    )


def take(ingest, *events):
    ingest.take(EventBatch(machine_id=events[0].machine_id, boot_id="b", events=events))


def pending(machine_id, policy_sha256, count, *, is_rollback):
    return Deployment(
        machine_id=machine_id,
        mode="2d",
        deployment_count=count,
        policy_sha256=policy_sha256,
        is_rollback=is_rollback,
        reason="test",
        created_by="eve",
        created_utc=START,
        outcome="pending",
        detail="",
        ended_utc=None,
    )


def aboard(assembled, machine_id, time):
    view = assembled.parts.machine_policies.view(machine_id, time)
    return {policy.mode.value: policy.policy_sha256 for policy in view.policies}


def test_what_was_on_board_at_any_time_is_what_an_own_log_says(assembled, ingest):
    """1000 times of two machines that change versions, go back, lose one, and report hours later."""
    draw = random.Random(5)
    log = {"m001": [], "m002": []}
    for machine_id, kept in log.items():
        time, waiting = START, []
        for sequence in range(1, 60):
            time += timedelta(milliseconds=draw.randrange(1, 40_000_000))
            versions = {mode: draw.choice(VERSIONS) for mode in ("2d", "3d")}
            if draw.random() < 0.1:
                del versions[draw.choice(("2d", "3d"))]
            kept.append((time, {mode: versions.get(mode) for mode in ("2d", "3d")}))
            waiting.append(booted(machine_id, sequence, time, versions))
            if draw.random() < 0.4:
                # Connected again: what happened meanwhile arrives at once, some of it twice.
                take(ingest, *waiting)
                waiting = waiting[-1:]
        take(ingest, *waiting)
    span_ms = int((max(kept[-1][0] for kept in log.values()) - START) / timedelta(milliseconds=1))
    for _ in range(1000):
        machine_id = draw.choice(("m001", "m002"))
        kept = log[machine_id]
        time = START + timedelta(milliseconds=draw.randrange(span_ms + 1000))
        place = bisect.bisect_right([row[0] for row in kept], time)
        assert aboard(assembled, machine_id, time) == (kept[place - 1][1] if place else {})


def test_starts_with_the_same_version_are_one_row(assembled, ingest):
    for sequence in range(1, 4):
        time = START + timedelta(hours=sequence)
        take(ingest, booted("m001", sequence, time, {"2d": "a" * 64}))
    view = assembled.parts.machine_policies.view("m001", None)
    assert [(p.mode, p.since_utc) for p in view.policies] == [
        ("2d", START + timedelta(hours=1)),
        ("3d", START + timedelta(hours=1)),
    ]
    assert view.policies[1].policy_sha256 is None


def test_a_clock_that_was_set_back_or_far_ahead_does_not_hide_the_newest(assembled, ingest):
    take(ingest, booted("m001", 1, START, {"2d": "a" * 64}))
    take(ingest, booted("m001", 2, START - timedelta(days=400), {"2d": "b" * 64}))
    assert aboard(assembled, "m001", START)["2d"] == "b" * 64
    take(ingest, booted("m001", 3, START + timedelta(days=40_000), {"2d": "c" * 64}))
    assert aboard(assembled, "m001", None)["2d"] == "c" * 64


def test_nul_characters_in_what_a_machine_says_of_its_policies_do_no_harm(assembled, ingest):
    ingest.on_store.append(assembled.parts.deployments.record)
    take(ingest, booted("m001", 1, START, {"2d": "a\x00b"}))
    data = {"mode": "2d", "policy_sha256": "c\x00", "deployment_count": 1, "detail": "\x00"}
    event = booted("m001", 2, START + timedelta(hours=1), None)
    take(ingest, event.model_copy(update={"kind": EventKind.POLICY_SWITCHED, "data": data}))
    assert aboard(assembled, "m001", START)["2d"] == "ab"
    assert aboard(assembled, "m001", None)["2d"] == "c"


DEPLOYED, BACK, AT_MACHINE, ITSELF = "deployed", "back", "at machine", "itself"
WAYS = {
    # How the machine came to a version; which one a rollback leads to; which one was taken away.
    "deployments": [(DEPLOYED, "a", "", ""), (DEPLOYED, "b", "a", ""), (DEPLOYED, "c", "b", "")],
    "back step by step": [
        (DEPLOYED, "a", "", ""),
        (DEPLOYED, "b", "a", ""),
        (DEPLOYED, "c", "b", ""),
        (BACK, "b", "a", "c"),
        (BACK, "a", "", "b"),
    ],
    "back and deployed anew": [
        (DEPLOYED, "a", "", ""),
        (DEPLOYED, "b", "a", ""),
        (BACK, "a", "", "b"),
        (DEPLOYED, "b", "a", ""),
        (BACK, "a", "", "b"),
        (DEPLOYED, "c", "a", ""),
    ],
    "back at the machine": [
        (ITSELF, "a", "", ""),
        (DEPLOYED, "b", "a", ""),
        (AT_MACHINE, "a", "", "b"),
        (DEPLOYED, "c", "a", ""),
    ],
    "the same deployed twice": [
        (DEPLOYED, "a", "", ""),
        (DEPLOYED, "b", "a", ""),
        (DEPLOYED, "a", "b", ""),
        (BACK, "b", "", "a"),
    ],
    "back at the server to one it never had": [
        (DEPLOYED, "a", "", ""),
        (DEPLOYED, "b", "a", ""),
        (BACK, "c", "a", "b"),
    ],
    "started with the one before": [
        (ITSELF, "a", "", ""),
        (DEPLOYED, "b", "a", ""),
        (ITSELF, "a", "", ""),
        (ITSELF, "b", "a", ""),
    ],
}


@each("case", WAYS)
def test_a_rollback_leads_to_no_version_that_was_rolled_back(assembled, ingest, case):
    ingest.on_store = [
        assembled.parts.machine_policies.record,
        assembled.parts.deployments.record,
    ]
    database, machine_id, steps = assembled.parts.database, case.replace(" ", "-")[:32], WAYS[case]
    with database.write() as session:
        session.add(machine(machine_id))
    before = taken = ""
    for count, (way, letter, before, taken) in enumerate(steps, 1):
        sha256 = letter * 64
        data = {"mode": "2d", "policy_sha256": sha256, "slot": sha256, "deployment_count": None}
        if way in (DEPLOYED, BACK):
            data["deployment_count"] = count
            with database.write() as session:
                session.add(pending(machine_id, sha256, count, is_rollback=way == BACK))
        event = booted(machine_id, count, START + timedelta(hours=count), {"2d": sha256})
        if way != ITSELF:
            event = event.model_copy(update={"kind": EventKind.POLICY_SWITCHED, "data": data})
        take(ingest, event)
        with database.read() as session:
            found = rollback_of(session, machine_id, Mode.PLANAR)
        assert found == tuple(one * 64 or None for one in (before, taken)), count
    with database.read() as session:
        # Versions that the machine may still load stay.
        assert all(machines_that_need(session, one * 64) for one in {before, taken} - {""})


def test_a_start_after_a_rollback_whose_end_was_not_reported_is_one(assembled, ingest):
    ingest.on_store.append(assembled.parts.deployments.record)
    for count, letter in enumerate("aba", 1):
        with assembled.parts.database.write() as session:
            session.add(pending("m001", letter * 64, count, is_rollback=count == 3))
        take(ingest, booted("m001", count, START, {"2d": letter * 64}))
    view = assembled.parts.machine_policies.view("m001", None).policies[0]
    assert (view.version_before, view.rolled_back_from) == (None, "b" * 12)


def test_an_older_machine_that_does_not_say_adds_nothing(assembled, ingest):
    take(ingest, booted("m001", 1, START, None))
    with assembled.parts.database.read() as session:
        assert session.query(MachinePolicy).count() == 0
    with pytest.raises(NotFoundError):
        assembled.parts.machine_policies.view("nobody", None)


def test_the_interface_answers_with_names_and_refuses_what_is_no_time(running, machine, ada):
    sha256 = running.parts.policies.active("2d").card.policy_sha256
    event = machine.event(EventKind.BOOTED, policy_sha256={"2d": sha256, "3d": "d" * 64})
    from tests.server.server_bench import wait_for

    def view():
        return ada.get("/machines/m001/policies").json()

    wait_for(lambda: [p["policy_sha256"] for p in view()["policies"]] == [sha256, "d" * 64])
    assert [p["policy_id"] for p in view()["policies"]] == ["swing-2d", "d" * 12]
    assert view()["policies"][0]["since_utc"][:19] <= event.t_utc[:19]
    early = ada.get("/machines/m001/policies", params={"at": "2001-01-01T00:00:00"})
    assert early.json()["policies"] == []
    assert ada.get("/machines/m001/policies", params={"at": "soon"}).status_code == 422


@pytest.mark.parametrize(
    ("at", "known"), [("0001-01-01T00:00:00+23:59", []), ("9999-12-31T23:59:59-14:00", ["a" * 64])]
)
def test_times_beyond_the_calendar_of_utc_are_its_first_and_last(assembled, ingest, at, known):
    take(ingest, booted("m001", 1, START, {"2d": "a" * 64}))
    found = aboard(assembled, "m001", datetime.fromisoformat(at))
    assert ([found["2d"]] if found else []) == known
    # As the machine's own time it neither fails nor hides what is newer.
    early = booted("m002", 1, START, {"2d": "b" * 64}).model_copy(update={"t_utc": at})
    take(ingest, early, booted("m002", 2, START, {"2d": "c" * 64}))
    assert aboard(assembled, "m002", None)["2d"] == "c" * 64
