import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from email import message_from_bytes, policy

import pytest
from aiosmtpd.controller import Controller
from sqlalchemy import select

from machine.conventions import Mode
from machine.errors import UsageError
from server.alerts import notification_outbox, notification_sender
from server.alerts.alert_rules import Judgement, Subject
from server.alerts.notification_outbox import (
    ATTEMPTS_COUNT,
    LAST_RETRY_S,
    NotificationOutbox,
    retry_delay_s,
)
from server.alerts.notification_sender import NotificationSender
from server.clock import utc_now
from server.errors import ApiError, NotFoundError
from server.plans.policy_life import change_state
from server.schemas.alerts import AlertRule
from server.schemas.console import Role
from server.schemas.deployments import DeployRequest
from server.schemas.notifications import WebhookRequest
from server.schemas.policies import PolicyState
from server.settings import Settings, load_settings
from server.store.alert_models import Notification
from server.store.models import Audit
from tests.cases import each
from tests.ports import free_port
from tests.server.alerts.receiver import Receiver, receiving
from tests.waiting import wait_for

STOPPED = Subject(AlertRule.STOPPED, "m001")


class Outbox:
    """The outbox of assembled parts that may send inside this computer, and alerts that fill it."""

    def __init__(self, assembled, **settings: object):
        parts = assembled.parts
        changes = {"webhook_private": True, **settings}
        self.settings = Settings.model_validate(parts.settings.model_dump() | changes)
        self.box = NotificationOutbox(parts.database, parts.audit, self.settings)
        self.database, self.alerts = parts.database, parts.alerting.alerts
        self.session = assembled.session("root")
        self.alerts.on_change[:] = [self.box.add_alert]

    def open_and_clear(self, text: str = "Stopped: a.") -> None:
        self.alerts.judge([Judgement(STOPPED, text)])
        self.alerts.judge([Judgement(STOPPED, None)])

    def rows(self):
        return self.box.page(None, 100).rows

    def hook(self, url: str, *topics: str) -> str:
        body = WebhookRequest.model_validate({"url": url} | ({"topics": topics} if topics else {}))
        return self.box.create(body, self.session).webhook.webhook_id

    @contextmanager
    def sending(self) -> Iterator[None]:
        sender = NotificationSender(self.box, self.settings)
        sender.start()
        try:
            yield
        finally:
            sender.close()


@pytest.fixture
def outbox(assembled) -> Outbox:
    return Outbox(assembled)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as found:
        yield found


def test_delays_double_up_to_an_hour_and_end_after_days():
    delays = [retry_delay_s(count) for count in range(1, ATTEMPTS_COUNT)]
    assert delays == sorted(delays, key=lambda delay: delay or 0.0)
    assert delays[0] == 5.0
    assert delays[-1] == LAST_RETRY_S
    assert 2.5 * 86_400 < sum(delay or 0.0 for delay in delays) < 3.5 * 86_400
    assert retry_delay_s(ATTEMPTS_COUNT) is None


def test_a_message_is_stored_with_what_it_tells_of_or_not_at_all(outbox, receiver):
    outbox.hook(receiver.url, "alert.opened")

    def fail(*_: object) -> None:
        raise RuntimeError("the transaction fails")

    outbox.alerts.on_change.append(fail)
    outbox.open_and_clear()
    assert outbox.rows() == ()
    outbox.alerts.on_change.remove(fail)
    outbox.open_and_clear()
    assert [row.topic for row in outbox.rows()] == ["alert.opened"]


def test_a_silenced_alert_is_told_to_nobody(outbox, receiver):
    outbox.hook(receiver.url, "alert.opened")
    outbox.alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (alert,) = outbox.alerts.page().rows
    outbox.alerts.silence(alert.alert_id, 600.0, outbox.session)
    outbox.alerts.judge([Judgement(STOPPED, None)])
    outbox.alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    assert len(outbox.rows()) == 1


def test_the_end_of_an_alert_is_sent_where_its_beginning_was(outbox, receiver):
    outbox.hook(receiver.url, "alert.opened", "alert.cleared")
    outbox.alerts.judge([Judgement(STOPPED, "Stopped: a.")])
    (alert,) = outbox.alerts.page().rows
    outbox.alerts.silence(alert.alert_id, 600.0, outbox.session)
    outbox.alerts.judge([Judgement(STOPPED, None)])
    # The next one is silent from its beginning: neither is sent.
    outbox.alerts.judge([Judgement(STOPPED, "Stopped: b.")])
    outbox.alerts.judge([Judgement(STOPPED, None)])
    assert [row.topic for row in outbox.rows()] == ["alert.cleared", "alert.opened"]


def test_the_secret_is_said_once_and_written_into_no_audit(outbox, receiver):
    new = outbox.box.create(WebhookRequest(url=receiver.url), outbox.session)
    assert new.secret.startswith("whsec_")
    (shown,) = outbox.box.webhooks()
    assert new.secret not in shown.model_dump_json()
    with outbox.database.read() as database:
        assert all(new.secret not in row.detail_json for row in database.scalars(select(Audit)))


def test_a_message_is_repeated_with_its_id_until_it_is_taken(outbox, receiver, monkeypatch):
    monkeypatch.setattr(notification_outbox, "FIRST_RETRY_S", 0.05)
    receiver.answers = [500, 404]
    outbox.hook(receiver.url, "alert.opened", "alert.cleared")
    with outbox.sending():
        outbox.open_and_clear()
        wait_for(lambda: all(row.delivered_utc for row in outbox.rows()))
    cleared, opened = outbox.rows()
    assert (opened.topic, opened.attempts_count + cleared.attempts_count) == ("alert.opened", 4)
    assert opened.next_utc is None
    assert opened.answer == "status 200"
    assert set(receiver.ids()) == {opened.notification_id, cleared.notification_id}
    assert len(receiver.got) == 4
    body = json.loads(receiver.got[0][1])
    assert body["type"] == "alert.opened"
    assert body["data"]["machine_id"] == "m001"
    assert "secret" not in body["data"]


def test_a_receiver_that_is_away_is_tried_again_after_a_restart(assembled, outbox, receiver):
    outbox.hook(receiver.url, "alert.opened")
    outbox.open_and_clear()
    later = Outbox(assembled)
    with later.sending():
        wait_for(lambda: receiver.got)
    assert receiver.ids() == [outbox.rows()[0].notification_id]


def test_a_message_is_given_up_and_can_be_replayed(outbox, receiver):
    outbox.hook(receiver.url, "alert.opened")
    outbox.open_and_clear()
    (row,) = outbox.rows()
    for count in range(ATTEMPTS_COUNT):
        assert outbox.rows()[0].next_utc is not None, count
        outbox.box.note(row.notification_id, is_delivered=False, answer="status 500")
    (given_up,) = outbox.rows()
    assert (given_up.next_utc, given_up.delivered_utc) == (None, None)
    assert outbox.box.due() == []
    again = outbox.box.replay(row.notification_id, outbox.session)
    assert (again.notification_id, again.attempts_count) == (row.notification_id, 0)
    with outbox.sending():
        wait_for(lambda: outbox.rows()[0].delivered_utc)
    assert receiver.ids() == [row.notification_id]
    with pytest.raises(NotFoundError):
        outbox.box.replay("nobody", outbox.session)


def test_a_removed_webhook_gets_nothing_more(outbox, receiver):
    webhook_id = outbox.hook(receiver.url, "alert.opened")
    outbox.open_and_clear()
    outbox.box.remove(webhook_id, outbox.session)
    assert outbox.box.webhooks() == []
    assert outbox.box.due() == []
    (row,) = outbox.rows()
    assert row.answer == "the webhook was removed"
    with pytest.raises(ApiError, match="removed"):
        outbox.box.replay(row.notification_id, outbox.session)
    with pytest.raises(NotFoundError):
        outbox.box.remove(webhook_id, outbox.session)


def test_only_what_is_due_is_tried_and_a_test_message_can_be_asked_for(outbox, receiver):
    webhook_id = outbox.hook(receiver.url)
    asked = outbox.box.test(webhook_id, outbox.session)
    assert [message.notification_id for message, _ in outbox.box.due()] == [asked.notification_id]
    with outbox.database.write() as database:
        row = database.get(Notification, asked.notification_id)
        assert row is not None
        row.next_utc = utc_now() + timedelta(hours=1)
    assert outbox.box.due() == []


def test_a_receiver_that_is_away_starves_no_other(outbox, receiver):
    dead_id = outbox.hook("http://127.0.0.1:9/hook", "deployment.changed")
    first, *_ = (outbox.box.test(dead_id, outbox.session) for _ in range(60))
    outbox.hook(receiver.url, "alert.opened")
    outbox.open_and_clear()
    due = outbox.box.due()
    assert len(due) == 2
    assert due[0][0].notification_id == first.notification_id
    with outbox.sending():
        wait_for(lambda: receiver.got)


def test_any_error_while_sending_is_a_failed_attempt(outbox, receiver, monkeypatch):
    def fail(*_: object) -> None:
        raise ValueError("smtp://user:word@host")

    monkeypatch.setattr(notification_sender, "send", fail)
    outbox.hook(receiver.url, "alert.opened")
    outbox.open_and_clear()
    with outbox.sending():
        wait_for(lambda: outbox.rows()[0].attempts_count)
    (row,) = outbox.rows()
    assert (row.answer, row.attempts_count) == ("ValueError", 1)


def test_what_could_not_be_noted_is_not_sent_again_at_once(outbox, receiver, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        tried.append(None)
        raise RuntimeError("the disk is full")

    tried: list[None] = []
    monkeypatch.setattr(outbox.box, "note", fail)
    monkeypatch.setattr(notification_sender, "PERIOD_S", 0.02)
    outbox.hook(receiver.url, "alert.opened")
    outbox.open_and_clear()
    with outbox.sending():
        wait_for(lambda: tried)
        time.sleep(0.3)
    assert len(receiver.got) == len(tried) == 1


def test_the_audit_names_the_host_of_a_webhook_and_not_its_path(outbox):
    webhook_id = outbox.hook("http://127.0.0.1:9/services/T0KEN?key=T0KEN")
    outbox.box.remove(webhook_id, outbox.session)
    with outbox.database.read() as database:
        rows = database.scalars(select(Audit).where(Audit.action.like("webhook.%"))).all()
        details = [row.detail_json for row in rows]
    assert len(details) == 2
    assert all("http://127.0.0.1" in detail and "T0KEN" not in detail for detail in details)


def test_an_address_inside_a_network_is_refused_when_it_is_added_and_when_it_is_sent_to(assembled):
    careful = Outbox(assembled, webhook_private=False)
    with pytest.raises(Exception, match="https"):
        careful.hook("http://127.0.0.1:9/hook")
    with pytest.raises(Exception, match="inside a network"):
        careful.hook("https://127.0.0.1:9/hook")
    with receiving() as receiver:
        Outbox(assembled).hook(receiver.url, "alert.opened")
        careful.open_and_clear()
        with careful.sending():
            wait_for(lambda: careful.rows() and careful.rows()[0].attempts_count)
        assert receiver.got == []
        assert careful.rows()[0].answer == "A webhook's address begins with https://."


def test_a_deployment_is_told_of(assembled, receiver):

    parts = assembled.parts
    outbox = Outbox(assembled)
    outbox.hook(receiver.url, "deployment.changed")
    parts.deployments.on_change[:] = [outbox.box.add_deployment]
    parts.approvals.start()
    sha256 = next(p.policy_sha256 for p in parts.policies.views() if p.mode is Mode.PLANAR)
    session = assembled.session("eve", Role.ENGINEER)
    request = DeployRequest(policy_sha256=sha256, reason="wider")
    for _ in range(2):
        parts.deployments.deploy("m001", Mode.PLANAR, request, session)
    with outbox.database.read() as database:
        query = select(Notification.body).order_by(Notification.notification_id)
        bodies = [json.loads(body) for body in database.scalars(query)]
    assert [body["data"]["outcome"] for body in bodies] == ["pending", "replaced", "pending"]


def test_a_step_of_a_policy_version_is_reported_with_it_or_not_at_all(assembled, receiver):
    parts = assembled.parts
    outbox = Outbox(assembled)
    outbox.hook(receiver.url, "policy.changed")
    sha256 = parts.policies.views()[0].policy_sha256

    def retire(fails: bool) -> None:
        with parts.database.write() as database:
            change_state(
                database, sha256, PolicyState.RETIRED, actor="eve", reason="worn", evidence={}
            )
            if fails:
                raise RuntimeError("the transaction fails")

    with pytest.raises(RuntimeError):
        retire(fails=True)
    assert outbox.rows() == ()
    retire(fails=False)
    ((message, _),) = outbox.box.due()
    data = json.loads(message.body)["data"]
    assert (data["policy_sha256"], data["to_state"], data["actor"]) == (sha256, "retired", "eve")


class Inbox:
    """What an SMTP server takes."""

    def __init__(self) -> None:
        self.mails: list[bytes] = []

    async def handle_DATA(self, _server: object, _session: object, envelope) -> str:  # noqa: N802  aiosmtpd calls it so
        self.mails.append(envelope.content)
        return "250 taken"


def test_an_opened_alert_is_mailed_through_a_real_smtp_server(assembled):
    inbox = Inbox()
    port = free_port()
    controller = Controller(inbox, hostname="127.0.0.1", port=port)
    controller.start()
    try:
        outbox = Outbox(
            assembled,
            smtp_url=f"smtp://127.0.0.1:{port}",
            mail_from="downrange@yard.example",
            mail_to=("duty@yard.example", "boss@yard.example"),
        )
        outbox.open_and_clear("Stopped: ümlaut in the pit.")
        with outbox.sending():
            wait_for(lambda: inbox.mails)
            wait_for(lambda: outbox.rows()[0].delivered_utc)
    finally:
        controller.stop()
    (mail,) = (message_from_bytes(raw, policy=policy.default) for raw in inbox.mails)
    assert mail["Subject"] == "Downrange: m001: stopped"
    assert mail["To"] == "duty@yard.example, boss@yard.example"
    assert "Stopped: ümlaut in the pit." in mail.get_content()
    assert [row.topic for row in outbox.rows()] == ["alert.opened"]


def test_a_mail_that_cannot_be_sent_waits(assembled):
    outbox = Outbox(
        assembled,
        smtp_url="smtp://127.0.0.1:9",
        mail_from="downrange@yard.example",
        mail_to=("duty@yard.example",),
    )
    outbox.open_and_clear()
    with outbox.sending():
        wait_for(lambda: outbox.rows()[0].attempts_count)
    (row,) = outbox.rows()
    assert row.next_utc is not None
    assert row.answer.startswith("ConnectionRefusedError")


def test_a_mail_to_a_bad_port_is_a_failed_attempt(assembled):
    outbox = Outbox(
        assembled,
        smtp_url="smtp://yard.example:port",
        mail_from="downrange@yard.example",
        mail_to=("duty@yard.example",),
    )
    outbox.open_and_clear()
    with outbox.sending():
        wait_for(lambda: outbox.rows()[0].attempts_count)
    assert outbox.rows()[0].answer == "ValueError"


@each(
    ("settings", "said"),
    [
        ({"smtp_url": "http://x"}, "smtp://"),
        ({"smtp_url": "smtp://x"}, "mail_from and mail_to"),
    ],
)
def test_mail_settings_are_whole_or_refused(settings: dict[str, str], said: str):
    with pytest.raises(UsageError, match=said):
        load_settings({}, **settings)
