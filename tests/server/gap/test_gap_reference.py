"""Healthy throws that a diagnosis is compared with: asked for, checked, kept, handed on."""

import json

import pytest
from alembic import command
from sqlalchemy import create_engine, text

from diagnosis.loading.kept_reference import kept_reference
from server.gap.gap_store import GapStore
from server.store.database import Database, alembic_config, upgrade
from tests.cases import each
from tests.server import gap_fakes
from tests.server.gap_bench import RUNS, add_throws, diagnosing, ended, forget_throws, start


@pytest.fixture(scope="module")
def throws(running):
    """Twelve throws of m001, oldest first: four while it was healthy, eight after."""
    forget_throws(running.parts)
    return add_throws(running.parts, 12)


def test_a_run_keeps_what_it_was_compared_with(running, ada, throws):
    healthy, later = throws[:4], throws[4:]
    with diagnosing(running.parts, gap_fakes.quick):
        asked = start(ada, throw_ids=later, reference_throw_ids=list(reversed(healthy)))
        assert (asked["throw_count"], asked["reference_throw_count"]) == (8, 4)
        view = ended(ada, asked)
        assert view["reference_throw_ids"] == healthy
        assert (view["result"]["evidence"]["logs"], view["result"]["evidence"]["healthy"]) == (8, 4)
        # The same again, as the console asks for it.
        again = start(
            ada, throw_ids=view["throw_ids"], reference_throw_ids=view["reference_throw_ids"]
        )
        assert ended(ada, again)["reference_throw_ids"] == healthy
    listed = ada.get(RUNS).json()["rows"][0]
    assert (listed["gap_run_id"], listed["reference_throw_count"]) == (again["gap_run_id"], 4)
    with running.client("root") as root:
        rows = root.get("/audit", params={"machine_id": "m001"}).json()["rows"]
    assert next(r for r in rows if r["action"] == "gap.run")["detail"]["reference_throw_count"] == 4


def test_without_any_it_is_compared_with_the_type(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.quick):
        view = ended(ada, start(ada, throw_ids=throws[4:]))
    assert view["row"]["reference_throw_count"] == 0
    assert view["reference_throw_ids"] == []
    assert view["result"]["evidence"]["healthy"] == 0


def test_the_newest_are_taken_beside_the_healthy_ones(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.quick):
        view = ended(ada, start(ada, newest_count=8, reference_throw_ids=throws[-4:]))
    assert view["throw_ids"] == throws[:8]


@each(
    ("change", "status", "said"),
    [
        ({"reference_throw_ids": [0, 1]}, 422, "at least 3 items"),
        ({"reference_throw_ids": []}, 422, "at least 3 items"),
        ({"reference_throw_ids": [0, 1, 1]}, 422, "named twice"),
        ({"reference_throw_ids": [2, 3, 4]}, 422, "1 throws are to be diagnosed and"),
        ({"reference_throw_ids": [0, 1, "x"]}, 409, "1 of 3 throws to compare with are not landed"),
        ({"reference_throw_ids": [0, 1, "other machine"]}, 409, "landed throws of m001 with a log"),
        ({"reference_throw_ids": [0, 1, "no log"]}, 409, "1 of 3 throws to compare with"),
        (
            {"throw_ids": None, "newest_count": 60, "reference_throw_ids": list(range(8))},
            409,
            "m001 has 4 landed throws with a log beside the 8 to compare with",
        ),
    ],
)
def test_throws_that_cannot_be_compared_with_are_refused(
    running, ada, throws, change, status, said
):
    parts = running.parts
    named = {
        "other machine": lambda: add_throws(parts, 1, machine_id="m002")[0],
        "no log": lambda: add_throws(parts, 1, has_log=False)[0],
    }

    def throw_id(place):
        return throws[place] if isinstance(place, int) else named.get(place, lambda: place)()

    body = {"throw_ids": throws[4:], **change}
    body["reference_throw_ids"] = [throw_id(place) for place in change["reference_throw_ids"]]
    reply = ada.post(RUNS, json={key: value for key, value in body.items() if value is not None})
    assert reply.status_code == status, reply.text
    assert said in reply.json()["error"]["message"]


def test_a_healthy_set_that_cannot_be_read_fails_with_its_reason(running, ada, throws):
    """The message of a refusal reaches people without the name of its class."""
    with diagnosing(running.parts, gap_fakes.refusing):
        row = ended(ada, start(ada, throw_ids=throws[4:], reference_throw_ids=throws[:3]))["row"]
    assert (row["state"], row["detail"]) == ("failed", "0 usable healthy throws to compare with")


def test_runs_from_before_were_compared_with_the_type(database_url):
    """A database of the schema before keeps its diagnoses."""
    config = alembic_config(database_url)
    command.upgrade(config, "0004")
    engine = create_engine(database_url)
    now = "2026-11-20 10:00:00.000000"
    machine = {"machine_id": "m001", "site": "site", "name": "", "token_sha256": "0" * 64}
    machine |= {"is_listed": True, "enrolled_utc": now}
    run = {"gap_run_id": "r1", "machine_id": "m001", "created_by": "ada", "created_utc": now}
    run |= {"state": "done", "detail": "", "throw_ids": json.dumps(["a", "b"]), "sentence": ""}
    run |= {"profile_version_count": 0, "profile_sha256": "0" * 64, "effect_count": 0}
    with engine.begin() as connection:
        for table, row in (("machines", machine), ("gap_runs", run)):
            marks = ", ".join(f":{name}" for name in row)
            statement = text(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({marks})")
            connection.execute(statement, row)
    engine.dispose()
    upgrade(database_url)
    database = Database(database_url)
    view = GapStore(database).view("r1", "m001")
    database.close()
    assert view.throw_ids == ("a", "b")
    assert view.reference_throw_ids == ()
    assert view.row.reference_throw_count == 0


@pytest.fixture
def kept(running, monkeypatch, tmp_path):
    """Reference throws of two days that commissioning has kept; calling it keeps so many a day."""
    monkeypatch.setattr(
        running.parts.gap._twins,
        "reference",
        lambda machine_id: kept_reference(tmp_path, machine_id),
    )

    def keep(count):
        for day in ("2026-05-01", "2026-05-02"):
            folder = kept_reference(tmp_path, "m001").folder / day
            folder.mkdir(parents=True, exist_ok=True)
            for number in range(count):
                (folder / f"m001-{day}-{number:02d}.mcap").touch()

    return keep


def test_kept_throws_are_compared_with_unless_the_type_is_asked_for(running, ada, throws, kept):
    kept(12)
    with diagnosing(running.parts, gap_fakes.quick):
        view = ended(ada, start(ada, throw_ids=throws[4:]))
        assert view["row"]["reference_throw_count"] == 24
        assert view["result"]["evidence"]["healthy"] == 24
        assert view["reference_throw_ids"][0] == "m001-2026-05-01-00"
        # The same again, as the console asks for it.
        again = {key: view[key] for key in ("throw_ids", "reference_throw_ids")}
        assert ended(ada, start(ada, **again))["result"]["evidence"]["healthy"] == 24
        of_type = ended(ada, start(ada, throw_ids=throws[4:], against="type"))
        assert of_type["result"]["evidence"]["healthy"] == 0
        ticked = ended(ada, start(ada, throw_ids=throws[4:], reference_throw_ids=throws[:4]))
        assert ticked["reference_throw_ids"] == throws[:4]
    said = ada.get("/machines/m001/kept-reference").json()
    assert said["day_throw_count"] == {"2026-05-01": 12, "2026-05-02": 12}
    assert said["is_used"]
    assert said["words"] == "24 reference throws of 2026-05-01 and 2026-05-02."


def test_too_few_kept_throws_are_not_compared_with(running, ada, throws, kept):
    kept(3)
    with diagnosing(running.parts, gap_fakes.quick):
        view = ended(ada, start(ada, throw_ids=throws[4:]))
    assert view["row"]["reference_throw_count"] == 0
    said = ada.get("/machines/m001/kept-reference").json()
    assert not said["is_used"]
    assert "6 reference throws are too few, at least 12" in said["words"]
