from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import trustme

from machine.messages import EventKind
from server.alerts.alert_rules import Judgement, Subject
from server.alerts.alert_watch import PERIOD_S, AlertWatch, expiry
from server.machines.machine_registry import FRESH_S
from server.schemas.alerts import AlertRule
from tests.server.server_bench import clear_stop, make_settings, running_server, wait_for
from tests.server.test_events import Listener


def alerts_of(client, rule: str, state: str = "open"):
    rows = client.get("/alerts", params={"state": state, "rule": rule}).json()["rows"]
    return [row for row in rows if row["machine_id"] == "m001"]


def test_a_lost_machine_opens_an_alert_that_ends_when_it_is_back(running, ada):
    with Listener(ada) as listener:
        machine = running.machine()
        with machine:
            wait_for(lambda: running.parts.registry.is_connected("m001"))
            wait_for(lambda: not alerts_of(ada, "lost"))
        (row,) = wait_for(lambda: alerts_of(ada, "lost"))
        opened = datetime.fromisoformat(row["opened_utc"])
        seen = running.parts.registry.get("m001").last_seen_utc
        # By the server's own times: a busy computer delays the test, not what the server noted.
        # A last state may be taken after the machine's token went, so `seen` may be the later one.
        assert abs(opened - seen) < timedelta(seconds=10)
        told = wait_for(
            lambda: [
                event
                for event in listener.of("alert.updated")
                if event["alert"]["alert_id"] == row["alert_id"]
            ]
        )
        assert told[0]["alert"]["cleared_utc"] is None
        assert [e for e in listener.of("alert") if e["code"] == "alert.lost"]
        path = f"/alerts/{row['alert_id']}/acknowledge"
        assert ada.post(path, json={"note": "battery"}).json()["acknowledged_by"] == "ada"
        with running.machine():
            wait_for(lambda: not alerts_of(ada, "lost"))
        (newest, *_) = alerts_of(ada, "lost", "cleared")
        assert newest["alert_id"] == row["alert_id"]
        assert newest["note"] == "battery"


def test_a_stopped_machine_has_an_alert_until_the_stop_is_cleared(running, ada, machine):
    ada.post("/machines/m001/stop")
    (row,) = wait_for(lambda: alerts_of(ada, "stopped"))
    assert row["severity"] == "error"
    with running.client("sue") as sue:
        wait_for(lambda: clear_stop(sue).status_code == 200)
    wait_for(lambda: not alerts_of(ada, "stopped"))


def test_refused_arms_and_a_wrong_clock_are_found(running, ada, machine):
    for _ in range(3):
        machine.event(EventKind.COMMAND_REFUSED, command="arm", detail="hydraulics are off")
    (row,) = wait_for(lambda: alerts_of(ada, "arm_refused"))
    assert "hydraulics are off" in row["text"]
    # The stand-in's events bear one fixed date.
    assert wait_for(lambda: alerts_of(ada, "clock"))
    machine.event(EventKind.ARMED)
    wait_for(lambda: not alerts_of(ada, "arm_refused"))


def losses(running, *, is_open: bool | None = None):
    alerts = running.parts.alerting.alerts
    return alerts.page(machine_id="m001", rule=AlertRule.LOST, is_open=is_open).rows


def test_after_a_restart_a_machine_that_connects_again_opens_nothing(tmp_path, swing_policies):
    settings = make_settings(tmp_path / "data", swing_policies)
    with running_server(settings) as first:
        with first.machine():
            wait_for(lambda: first.parts.registry.is_connected("m001"))
        wait_for(lambda: losses(first, is_open=True))
    with running_server(settings) as second:
        (row,) = losses(second)
        assert row.cleared_utc is None
        with second.machine():
            wait_for(lambda: second.parts.registry.is_connected("m001"))
            wait_for(lambda: not losses(second, is_open=True))
            assert [found.alert_id for found in losses(second)] == [row.alert_id]


def test_the_end_of_a_certificate_is_read(tmp_path):
    end = datetime(2040, 1, 2, tzinfo=UTC)
    path = tmp_path / "cert.pem"
    trustme.CA().issue_cert("server", not_after=end).cert_chain_pems[0].write_to_path(path)
    assert expiry(path) == end
    path.write_text("nothing")
    assert expiry(path) is None
    assert expiry(tmp_path / "none.pem") is None


def test_a_source_that_fails_holds_up_no_other_and_what_was_not_stored_is_judged_again(assembled):
    parts = assembled.parts
    alerts = parts.alerting.alerts
    watch = AlertWatch(alerts, parts.registry, parts.settings)
    news = [Judgement(Subject(AlertRule.DRIFT, "m001"), "drifts")]

    def broken() -> Iterator[Judgement]:
        raise RuntimeError("no history")

    def told_once() -> Iterator[Judgement]:
        while news:
            yield news.pop()

    def fail(*_: object) -> None:
        raise RuntimeError("the database is away")

    watch.sources += [broken, told_once]
    alerts.on_change[:] = [fail]
    watch.look()
    assert alerts.page(rule=AlertRule.DRIFT).rows == ()
    alerts.on_change.clear()
    watch.look()
    assert [row.text for row in alerts.page(rule=AlertRule.DRIFT).rows] == ["drifts"]


def test_a_silent_machine_is_noticed_within_the_bar_of_two_seconds():
    assert FRESH_S + PERIOD_S < 2.0
