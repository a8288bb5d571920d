"""The 3D view of a session shows the impacts of the machine it looks at, and the newest one in words."""

from datetime import UTC, datetime, timedelta

import pytest

from server.clock import id_at
from server.display.impact_display import SHOWN_COUNT, ImpactDisplay
from server.schemas.console import ViewRequest
from server.store.models import Throw

START = datetime(2026, 1, 1, tzinfo=UTC)


def throw(index, machine_id="m001", along_m: float | None = 0.25, across_m=-0.1):
    moment = START + timedelta(minutes=index)
    return Throw(
        throw_id=id_at(moment),
        machine_id=machine_id,
        plan_id="p",
        session_id="s",
        created_utc=moment,
        operator="ada",
        epoch_count=1,
        mode="2d",
        target_x_m=0.0,
        target_y_m=9.0,
        target_z_m=0.0,
        range_m=9.0,
        policy_id="policy",
        policy_sha256="a" * 64,
        phase="ended",
        outcome="landed",
        detail="",
        measured_downrange_error_m=along_m,
        measured_crossrange_error_m=None if along_m is None else across_m,
        has_log=False,
    )


@pytest.fixture
def shown(assembled, monkeypatch):
    """Calls of the scene, newest last: session, number of old marks, newest mark, its words."""
    calls = []

    def note(session_id, points_m, *, latest=None, latest_text=""):
        calls.append((session_id, len(points_m), latest, latest_text))

    monkeypatch.setattr(assembled.parts.scene, "show_impacts", note)
    return calls


@pytest.fixture
def board(assembled):
    return ImpactDisplay(assembled.parts.database, assembled.parts.scene)


def add(assembled, *throws):
    with assembled.parts.database.write() as database:
        database.add_all(throws)


def test_the_newest_miss_stands_beside_its_cross(assembled, board, shown):
    add(assembled, throw(0, along_m=0.1), throw(1, along_m=None), throw(2), throw(3, "m002", -0.4))
    board.watch("ada", "m001")
    session, past_count, latest, text = shown[-1]
    assert (session, past_count) == ("ada", 1)  # what did not land has no mark
    # Downrange is +y here, right of it is +x.
    assert latest == pytest.approx((0.1, 9.25, 0.0))
    assert text == "0.25 m long, 0.10 m right"


def test_a_new_impact_is_drawn_for_those_who_look_at_that_machine(assembled, board, shown):
    board.watch("ada", "m001")
    board.watch("bob", "m002")
    board.watch("vic", "m001")
    board.end_session("vic")
    assert shown[-1] == ("vic", 0, None, "")
    shown.clear()
    add(assembled, throw(0, along_m=-0.05, across_m=0.0))
    board.refresh("m001")
    assert [call[0] for call in shown] == ["ada"]
    assert shown[0][3] == "0.05 m short, 0.00 m left"


def test_only_so_many_crosses(assembled, board, shown):
    add(assembled, *(throw(index) for index in range(SHOWN_COUNT + 20)))
    board.watch("ada", "m001")
    assert shown[-1][1] == SHOWN_COUNT - 1


def test_a_changed_throw_reaches_the_board_of_the_running_server(assembled, shown):
    parts = assembled.parts
    row = throw(0)
    throw_id = row.throw_id
    add(assembled, row)
    parts.targets.set_view("ada", ViewRequest(machine_id="m001"))
    shown.clear()
    parts.throws.publish(throw_id)
    assert [call[0] for call in shown] == ["ada"]
