import asyncio
import itertools
import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from machine.messages import EventBatch, EventKind, MachineEvent, Target, ThrowPlan
from server.schemas.history import Outcome, ThrowPhase
from server.store.models import Event, Impact, Throw

BOOTS = itertools.count()


def event(sequence, kind=EventKind.BOOTED, throw_id=None, boot="b", **data):
    return MachineEvent(
        machine_id="m001",
        boot_id=boot,
        sequence_count=sequence,
        t_mono_ns=sequence * 1000,
        t_utc="2026-11-21T12:00:00+00:00",
        kind=kind,
        throw_id=throw_id,
        data=data,
    )


def batch(*events, boot="b"):
    return EventBatch(machine_id="m001", boot_id=boot, events=events)


@pytest.fixture
def throw_id(assembled):
    plan = ThrowPlan(
        plan_id="p1",
        machine_id="m001",
        mode="2d",
        target=Target(x_m=9.0, y_m=0.0),
        policy_sha256="a" * 64,
        model_sha256="b" * 64,
        twin_profile_version=0,
        predicted_impact_m=(9.1, 0.0, 0.0),
    )
    row = assembled.parts.throws.new_row("t1", plan, assembled.session(), 1)
    with assembled.parts.database.write() as database:
        database.add(row)
    return "t1"


@pytest.fixture
def ingest(assembled):
    from server.throws.event_ingest import EventIngest

    s = assembled.parts
    return EventIngest(s.database, s.throws, s.hub, s.metrics, s.policies.name_of)


def read(assembled, throw_id="t1"):
    with assembled.parts.database.read() as database:
        return database.get(Throw, throw_id)


def count(assembled, model):
    with assembled.parts.database.read() as database:
        return database.query(model).count()


def test_each_event_is_stored_once_however_often_it_comes(assembled, ingest):
    events = [event(n) for n in range(1, 6)]
    assert ingest.take(batch(*events[:3])).sequence_count == 3
    assert ingest.take(batch(*events)).sequence_count == 5
    assert ingest.take(batch(*events[1:4])).sequence_count == 4
    assert ingest.take(batch(events[0], events[0])).sequence_count == 1
    assert count(assembled, Event) == 5


def test_news_of_a_policy_name_version_hash_and_cause(assembled, ingest):
    card = assembled.parts.policies.active("2d").card
    sha256, known = card.policy_sha256, f"{card.policy_id} ({card.policy_sha256[:12]})"

    async def told(kind, **data):
        client = assembled.parts.hub.subscribe("s", None)
        ingest.take(batch(event(next(BOOTS), kind, mode="2d", **data), boot="news"))
        (frame,) = await client.wait(60.0)
        assembled.parts.hub.unsubscribe(client)
        return json.loads(frame.data)["text"]

    switched, refused = EventKind.POLICY_SWITCHED, EventKind.POLICY_REFUSED
    for kind, data, words in (
        (
            switched,
            {"policy_sha256": sha256, "slot": sha256, "deployment_count": 1},
            f"m001 throws with 2D policy {known}.",
        ),
        (
            switched,
            {"policy_sha256": sha256, "slot": sha256, "deployment_count": None},
            f"m001 throws with 2D policy {known}: rolled back at the machine.",
        ),
        (
            switched,
            {"policy_sha256": "d" * 64, "slot": None, "deployment_count": None},
            "m001 throws with 2D policy dddddddddddd.",
        ),
        (
            refused,
            {"policy_sha256": sha256, "detail": "it is cut off."},
            f"m001 refuses 2D policy {known}: it is cut off.",
        ),
        (
            refused,
            {"policy_sha256": None, "is_removed": True, "detail": "not approved"},
            "m001 refuses its 2D policy: not approved.",
        ),
    ):
        assert asyncio.run(told(kind, **data)) == words


def test_another_boot_is_another_series(assembled, ingest):
    ingest.take(batch(event(1, boot="x"), boot="x"))
    ingest.take(batch(event(1, boot="y"), boot="y"))
    assert count(assembled, Event) == 2


def test_empty_batch(assembled, ingest):
    assert ingest.take(batch()).sequence_count == -1


def test_a_throw_goes_through_its_phases(assembled, ingest, throw_id):
    ended = []
    ingest.on_throw_end.append(ended.append)
    ingest.take(batch(event(1, EventKind.THROW_ACCEPTED, throw_id)))
    assert read(assembled).phase == ThrowPhase.ACCEPTED
    ingest.take(batch(event(2, EventKind.THROW_STARTED, throw_id)))
    ingest.take(batch(event(3, EventKind.RELEASE_COMMANDED, throw_id)))
    assert read(assembled).phase == ThrowPhase.COMMITTED
    # Late: phases never go back.
    ingest.take(batch(event(4, EventKind.THROW_STARTED, throw_id)))
    assert read(assembled).phase == ThrowPhase.COMMITTED
    ingest.take(
        batch(
            event(
                5,
                EventKind.IMPACT,
                throw_id,
                position_m=[9.2, 0.1, 0.0],
                sd_m=0.02,
                source="survey",
            ),
            event(6, EventKind.THROW_ENDED, throw_id, outcome="landed", release_speed_m_per_s=8.0),
        )
    )
    row = read(assembled)
    assert (row.phase, row.outcome) == (ThrowPhase.ENDED, Outcome.LANDED)
    assert row.measured_downrange_error_m == pytest.approx(0.2)
    assert row.measured_crossrange_error_m == pytest.approx(0.1)
    assert (row.impact_source, row.release_speed_m_per_s) == ("survey", 8.0)
    assert ended == [throw_id]


def test_a_repeated_impact_adds_no_second_record(assembled, ingest, throw_id):
    impact = event(
        1, EventKind.IMPACT, throw_id, position_m=[9.2, 0.1, 0.0], sd_m=0.02, source="survey"
    )
    ingest.take(batch(impact))
    ingest.take(batch(impact))
    assert count(assembled, Impact) == 1


def test_a_manual_mark_is_not_overruled_by_a_late_survey(assembled, ingest, throw_id):
    from server.throws.impacts import add_impact

    with assembled.parts.database.write() as database:
        add_impact(
            database,
            database.get(Throw, throw_id),
            (9.5, 0.0, 0.0),
            "manual",
            sd_m=None,
            recorded_by="ada",
        )
    ingest.take(
        batch(
            event(
                1, EventKind.IMPACT, throw_id, position_m=[9.2, 0.1, 0.0], sd_m=0.0, source="survey"
            )
        )
    )
    assert read(assembled).measured_downrange_error_m == pytest.approx(0.5)
    assert count(assembled, Impact) == 2


UNUSABLE_IMPACTS = (
    {"position_m": [9.2, 0.1], "sd_m": 0.0, "source": "survey"},
    {"position_m": [float("nan"), 0.1, 0.0], "sd_m": 0.0, "source": "survey"},
    {"position_m": [float("inf"), 0.1, 0.0], "sd_m": float("nan"), "source": "survey"},
    {"position_m": "nine", "note": "\x00"},
    {},
)


def test_unusable_impacts_are_kept_as_events_and_block_nothing(assembled, ingest, throw_id):
    unusable = [
        event(number, EventKind.IMPACT, throw_id, **bad)
        for number, bad in enumerate(UNUSABLE_IMPACTS, 1)
    ]
    ended = event(len(unusable) + 1, EventKind.THROW_ENDED, throw_id, outcome="landed")
    ack = ingest.take(batch(*unusable, ended))
    assert ack.sequence_count == len(unusable) + 1
    assert (count(assembled, Event), count(assembled, Impact)) == (len(unusable) + 1, 0)
    assert read(assembled).outcome == "landed"


def test_unknown_outcome_word_blocks_nothing(assembled, ingest, throw_id):
    ingest.take(batch(event(1, EventKind.THROW_ENDED, throw_id, outcome="exploded")))
    assert count(assembled, Event) == 1


def test_another_machines_throw_is_not_touched(assembled, ingest, throw_id):
    other = event(1, EventKind.THROW_ENDED, throw_id, outcome="landed").model_copy(
        update={"machine_id": "m002"}
    )
    ingest.take(EventBatch(machine_id="m002", boot_id="b", events=(other,)))
    assert read(assembled).outcome is None


def test_events_of_unknown_throws_are_kept(assembled, ingest):
    ingest.take(batch(event(1, EventKind.THROW_ENDED, "never-heard-of", outcome="landed")))
    assert count(assembled, Event) == 1


def test_an_event_resolves_a_lost_answer(assembled, ingest, throw_id):
    throws = assembled.parts.throws
    throws.mark_unknown("m001", throw_id)
    assert throws.unknown_of("m001") == throw_id
    ingest.take(batch(event(1, EventKind.THROW_ACCEPTED, throw_id)))
    assert throws.unknown_of("m001") is None
    assert read(assembled).phase == ThrowPhase.ACCEPTED


def test_an_event_that_overtook_the_lost_answer_resolves_it_too(assembled, ingest, throw_id):
    ingest.take(batch(event(1, EventKind.THROW_ACCEPTED, throw_id)))
    assembled.parts.throws.mark_unknown("m001", throw_id)
    assert assembled.parts.throws.unknown_of("m001") is None


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.lists(st.lists(st.integers(0, 30), min_size=1, max_size=8), max_size=8))
def test_any_delivery_order_stores_the_union(assembled, ingest, deliveries):
    boot = f"boot{next(BOOTS)}"
    for numbers in deliveries:
        ack = ingest.take(batch(*(event(n, boot=boot) for n in numbers), boot=boot))
        assert ack.sequence_count == max(numbers)
    with assembled.parts.database.read() as database:
        stored = [row.sequence_count for row in database.query(Event).filter_by(boot_id=boot)]
    assert sorted(stored) == sorted({n for numbers in deliveries for n in numbers})
