from datetime import timedelta

import pytest

from server.alerts.alert_rules import RULES, Judgement, Subject
from server.alerts.alerts import Alerts
from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.schemas.alerts import AlertRule
from server.store.alert_models import AlertRow

STOPPED = Subject(AlertRule.STOPPED, "m001")
DISK = Subject(AlertRule.DISK, None)


@pytest.fixture
def alerts(assembled) -> Alerts:
    return assembled.parts.alerting.alerts


def reopened(assembled) -> Alerts:
    """As after a restart of the server."""
    parts = assembled.parts
    again = Alerts(parts.database, parts.audit, parts.hub)
    again.start()
    return again


def open_rows(alerts: Alerts):
    return alerts.page(is_open=True).rows


def test_a_condition_is_one_alert_until_it_is_gone(alerts):
    for text in ("Stopped: a.", "Stopped: a."):
        alerts.judge([Judgement(STOPPED, text)])
    (row,) = open_rows(alerts)
    assert (row.rule, row.machine_id, row.severity) == (AlertRule.STOPPED, "m001", "error")
    alerts.judge([Judgement(Subject(AlertRule.STOPPED, "m002"), None)])
    assert len(open_rows(alerts)) == 1
    alerts.judge([Judgement(STOPPED, None)])
    assert open_rows(alerts) == ()
    (row,) = alerts.page(is_open=False).rows
    assert row.cleared_utc is not None
    alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    assert [row.text for row in alerts.page().rows] == ["Stopped: b.", "Stopped: a."]


def test_an_open_alert_says_what_is_wrong_now(alerts, assembled):
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (row,) = open_rows(alerts)
    alerts.acknowledge(row.alert_id, "seen", assembled.session())
    alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    (renewed,) = open_rows(alerts)
    assert (renewed.alert_id, renewed.text) == (row.alert_id, "Stopped: b.")
    assert renewed.note == "seen"
    # A number that goes on changing is not written at every look.
    alerts.judge([Judgement(STOPPED, "Stopped: c.")])
    assert open_rows(alerts)[0].text == "Stopped: b."


def test_a_condition_that_comes_and_goes_is_one_alert(alerts):
    assert RULES[AlertRule.DISK].clear_after_s > 10.0
    alerts.judge([Judgement(DISK, "full")])
    alerts.judge([Judgement(DISK, None)])
    alerts.judge([Judgement(DISK, "full")])
    assert len(alerts.page().rows) == len(open_rows(alerts)) == 1


def test_open_alerts_survive_a_restart(assembled, alerts):
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    again = reopened(assembled)
    again.judge([Judgement(STOPPED, "Stopped: a.")])
    assert len(again.page().rows) == 1
    again.judge([Judgement(STOPPED, None)])
    assert open_rows(again) == ()


def test_a_person_acknowledges_once_with_a_note(assembled, alerts):
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (row,) = open_rows(alerts)
    view = alerts.acknowledge(row.alert_id, " on my way ", assembled.session("ada"))
    assert (view.acknowledged_by, view.note) == ("ada", "on my way")
    with pytest.raises(ConflictError, match="ada"):
        alerts.acknowledge(row.alert_id, "", assembled.session("bob"))
    with pytest.raises(NotFoundError):
        alerts.acknowledge("nobody", "", assembled.session("bob"))
    # It is open still, and the next one is a new one.
    (row,) = open_rows(alerts)
    assert row.acknowledged_utc is not None
    alerts.judge([Judgement(STOPPED, None)])
    alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    (row,) = open_rows(alerts)
    assert row.acknowledged_by is None


def test_a_silence_holds_for_the_next_alert_of_its_rule_and_machine_alone(assembled, alerts):
    other = Subject(AlertRule.STOPPED, "m002")
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (row,) = open_rows(alerts)
    until = alerts.silence(row.alert_id, 3600.0, assembled.session("ada")).silenced_until_utc
    assert until is not None and until > utc_now() + timedelta(minutes=59)
    alerts.judge([Judgement(STOPPED, None), Judgement(other, "Stopped: c.")])
    alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    rows = {row.machine_id: row for row in open_rows(alerts)}
    assert rows["m001"].silenced_until_utc == until
    assert rows["m001"].silenced_by == "ada"
    assert rows["m002"].silenced_until_utc is None
    ended = alerts.silence(rows["m001"].alert_id, 0.0, assembled.session("ada"))
    assert (ended.silenced_until_utc, ended.silenced_by) == (None, None)


def test_a_silence_that_is_over_is_not_taken_over(assembled, alerts):
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (row,) = open_rows(alerts)
    alerts.silence(row.alert_id, 3600.0, assembled.session())
    with assembled.parts.database.write() as database:
        stored = database.get(AlertRow, row.alert_id)
        assert stored is not None
        stored.silenced_until_utc = utc_now() - timedelta(seconds=1.0)
    alerts.judge([Judgement(STOPPED, None)])
    alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    assert open_rows(alerts)[0].silenced_until_utc is None


def test_changes_are_told_inside_their_transaction(assembled, alerts):
    told = []

    def fail(database, topic, view):
        told.append((topic, view.rule))
        raise RuntimeError("the listener failed")

    alerts.on_change.append(fail)
    assert len(alerts.judge([Judgement(STOPPED, "Stopped: a.")])) == 1
    assert told == [("alert.opened", AlertRule.STOPPED)]
    assert alerts.page().rows == ()
    alerts.on_change.clear()
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    assert len(open_rows(alerts)) == 1


def test_a_verdict_that_cannot_be_stored_holds_up_no_other(alerts):
    def fail(_: object, __: str, view) -> None:
        if view.machine_id == "m001":
            raise RuntimeError("the text cannot be stored")

    alerts.on_change[:] = [fail]
    failing = Judgement(STOPPED, "Stopped: a.")
    assert alerts.judge([failing, Judgement(DISK, "full")]) == [failing]
    assert [row.rule for row in open_rows(alerts)] == [AlertRule.DISK]


def test_a_text_is_stored_without_nul_and_of_bounded_length(alerts):
    alerts.judge([Judgement(STOPPED, "Stopped: \x00a." + "b" * 3000)])
    (row,) = open_rows(alerts)
    assert row.text.startswith("Stopped: a.bb")
    assert len(row.text) == 2000


def test_pages_and_filters(alerts):
    for count in range(5):
        alerts.judge([Judgement(Subject(AlertRule.FAULT, f"m00{count}"), "Fault: x.")])
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    first = alerts.page(limit=4)
    rest = alerts.page(limit=4, cursor=first.next_cursor)
    assert len(first.rows) == 4
    assert len(rest.rows) == 2
    assert rest.next_cursor is None
    assert {row.alert_id for row in first.rows}.isdisjoint(row.alert_id for row in rest.rows)
    assert len(alerts.page(machine_id="m001").rows) == 2
    assert len(alerts.page(rule=AlertRule.FAULT).rows) == 5


def test_what_people_do_is_in_the_audit(assembled, alerts):
    alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (row,) = open_rows(alerts)
    alerts.acknowledge(row.alert_id, "seen", assembled.session("ada"))
    alerts.silence(row.alert_id, 60.0, assembled.session("ada"))
    assert assembled.parts.audit.verify().row_count == 2
