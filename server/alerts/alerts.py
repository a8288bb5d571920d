"""Alerts from the moment their condition is found: opened, cleared, acknowledged, silenced; all are kept."""

import logging
import threading
import time
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from typing import Final, Literal

from sqlalchemy import select, update
from sqlalchemy.orm import Session as DatabaseSession

from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.alerts.alert_rules import RULES, Judgement, Subject
from server.clock import new_id, utc_now
from server.errors import ConflictError, NotFoundError
from server.event_hub import EventHub
from server.schemas.alerts import AlertPage, AlertRule, AlertView
from server.schemas.events import AlertUpdatedEvent
from server.store.alert_models import AlertRow
from server.store.database import Database

logger = logging.getLogger(__name__)

SEEN_PERIOD_S: Final = 30.0
"""How often `seen_utc` of open alerts is written, and the text of one that goes on changing."""
_ANNOUNCED_BY_EVENTS: Final = frozenset({AlertRule.STOPPED, AlertRule.FAULT})
"""The machine's own event is news to all browsers already (server/throws/event_ingest.py)."""

AlertTopic = Literal["alert.opened", "alert.cleared", "alert.acknowledged"]
AlertListener = Callable[[DatabaseSession, AlertTopic, AlertView], None]


class Alerts:
    """Keeps alerts; thread-safe."""

    def __init__(self, database: Database, audit: AuditChain, hub: EventHub) -> None:
        self._database = database
        self._audit = audit
        self._hub = hub
        self._lock = threading.RLock()
        self._open: dict[Subject, AlertView] = {}
        self._gone_since_s: dict[Subject, float] = {}
        self._renewed_s: dict[Subject, float] = {}
        self._seen_s = time.monotonic()
        self.on_change: list[AlertListener] = []
        """Called inside the transaction that stores the change."""

    def start(self) -> None:
        """Take up the alerts that were open when the server went down."""
        with self._lock, self._database.read() as database:
            for row in database.scalars(select(AlertRow).where(AlertRow.cleared_utc.is_(None))):
                view = _view(row)
                self._open[Subject(view.rule, view.machine_id)] = view

    # Rules ----------------------------------------------------------------------------------------

    def judge(self, verdicts: Iterable[Judgement]) -> list[Judgement]:
        """Open and clear alerts by what the rules say now; subjects without a verdict stay as they are.

        Returns:
            Verdicts that could not be stored; each stands for itself, the others hold.
        """
        now_s = time.monotonic()
        failed: list[Judgement] = []
        with self._lock:
            for verdict in verdicts:
                try:
                    self._take(verdict, now_s)
                except Exception:
                    logger.exception("the verdict about %s could not be stored", verdict.subject)
                    failed.append(verdict)
            if now_s - self._seen_s >= SEEN_PERIOD_S:
                self._seen_s = now_s
                try:
                    self._write_seen()
                except Exception:
                    logger.exception("open alerts could not be marked as seen")
        return failed

    def _take(self, verdict: Judgement, now_s: float) -> None:
        subject = verdict.subject
        is_open = subject in self._open
        if verdict.text is not None:
            self._gone_since_s.pop(subject, None)
            # PostgreSQL stores no NUL.
            text = verdict.text.replace("\x00", "")[:2000]
            if not is_open:
                self._add(subject, text)
            elif text != self._open[subject].text:
                self._renew(subject, text, now_s)
        elif is_open:
            since_s = self._gone_since_s.setdefault(subject, now_s)
            if now_s - since_s >= RULES[subject.rule].clear_after_s:
                self._clear(subject)

    def _add(self, subject: Subject, text: str) -> None:
        now_utc = utc_now()
        with self._database.write() as database:
            silence = self._silence_of(database, subject, now_utc)
            row = AlertRow(
                alert_id=new_id(),
                rule=subject.rule.value,
                severity=RULES[subject.rule].severity,
                machine_id=subject.machine_id,
                text=text,
                opened_utc=now_utc,
                seen_utc=now_utc,
                cleared_utc=None,
                acknowledged_by=None,
                acknowledged_utc=None,
                note="",
                silenced_until_utc=None if silence is None else silence.silenced_until_utc,
                silenced_by=None if silence is None else silence.silenced_by,
            )
            database.add(row)
            database.flush()
            view = self._store(database, "alert.opened", row)
        self._publish(view)
        is_news = view.severity == "error" and subject.rule not in _ANNOUNCED_BY_EVENTS
        if is_news and silence is None:
            self._hub.alert(
                f"alert.{view.rule.value}",
                text,
                severity=view.severity,
                machine_id=subject.machine_id,
            )

    def _renew(self, subject: Subject, text: str, now_s: float) -> None:
        """Say what is wrong now: at once the first time, then at most once a `SEEN_PERIOD_S`."""
        if now_s - self._renewed_s.get(subject, -1e9) < SEEN_PERIOD_S:
            return
        with self._database.write() as database:
            row = self._row(database, self._open[subject].alert_id)
            row.text, row.seen_utc = text, utc_now()
            database.flush()
            view = _view(row)
        self._renewed_s[subject] = now_s
        self._publish(view)

    @staticmethod
    def _silence_of(
        database: DatabaseSession, subject: Subject, now_utc: datetime
    ) -> AlertRow | None:
        """The last alert of a subject, if its silence still lasts."""
        query = select(AlertRow).where(
            AlertRow.rule == subject.rule.value,
            AlertRow.machine_id.is_(None)
            if subject.machine_id is None
            else AlertRow.machine_id == subject.machine_id,
        )
        last = database.scalars(query.order_by(AlertRow.alert_id.desc()).limit(1)).first()
        if last is None or last.silenced_until_utc is None or last.silenced_until_utc <= now_utc:
            return None
        return last

    def _clear(self, subject: Subject) -> None:
        now_utc = utc_now()
        with self._database.write() as database:
            row = self._row(database, self._open[subject].alert_id)
            row.cleared_utc = row.seen_utc = now_utc
            view = self._store(database, "alert.cleared", row)
        self._gone_since_s.pop(subject, None)
        self._renewed_s.pop(subject, None)
        self._publish(view)

    def _write_seen(self) -> None:
        ids = [
            view.alert_id
            for subject, view in self._open.items()
            if subject not in self._gone_since_s
        ]
        if not ids:
            return
        now_utc = utc_now()
        with self._database.write() as database:
            database.execute(
                update(AlertRow).where(AlertRow.alert_id.in_(ids)).values(seen_utc=now_utc)
            )

    # People ---------------------------------------------------------------------------------------

    def acknowledge(self, alert_id: str, note: str, session: Session) -> AlertView:
        """Note that a person has seen an alert.

        Raises:
            NotFoundError: no such alert.
            ConflictError: somebody has done so before.
        """
        with self._lock:
            with self._database.write() as database:
                row = self._row(database, alert_id)
                if row.acknowledged_by is not None:
                    raise ConflictError(
                        "already_acknowledged",
                        f"{row.acknowledged_by} has acknowledged this alert before.",
                    )
                row.acknowledged_by, row.acknowledged_utc = session.username, utc_now()
                row.note = note.strip()
                view = self._store(database, "alert.acknowledged", row)
                self._append(database, "alert.acknowledge", view, session, {"note": row.note})
            self._publish(view)
        return view

    def silence(self, alert_id: str, duration_s: float, session: Session) -> AlertView:
        """Let an alert, and the next of its rule and machine, call nobody for a while; 0 ends that.

        Raises:
            NotFoundError: no such alert.
        """
        with self._lock:
            with self._database.write() as database:
                row = self._row(database, alert_id)
                until_utc = utc_now() + timedelta(seconds=duration_s) if duration_s > 0.0 else None
                row.silenced_until_utc = until_utc
                row.silenced_by = None if until_utc is None else session.username
                database.flush()
                view = _view(row)
                detail = {"duration_s": duration_s}
                self._append(database, "alert.silence", view, session, detail)
            self._publish(view)
        return view

    def page(
        self,
        *,
        is_open: bool | None = None,
        machine_id: str | None = None,
        rule: AlertRule | None = None,
        cursor: str | None = None,
        limit: int = 100,
    ) -> AlertPage:
        """Alerts that match, newest first.

        Args:
            is_open: only those that are open, or only those that are cleared; None for both.
            machine_id: only of this machine.
            rule: only of this rule.
            cursor: `next_cursor` of the page before.
            limit: rows a page.
        """
        query = select(AlertRow).order_by(AlertRow.alert_id.desc()).limit(limit + 1)
        if is_open is not None:
            cleared = AlertRow.cleared_utc
            query = query.where(cleared.is_(None) if is_open else cleared.is_not(None))
        if machine_id is not None:
            query = query.where(AlertRow.machine_id == machine_id)
        if rule is not None:
            query = query.where(AlertRow.rule == rule.value)
        if cursor is not None:
            query = query.where(AlertRow.alert_id < cursor)
        with self._database.read() as database:
            rows = database.scalars(query).all()
        return AlertPage(
            rows=tuple(_view(row) for row in rows[:limit]),
            next_cursor=rows[limit - 1].alert_id if len(rows) > limit else None,
        )

    # Parts ----------------------------------------------------------------------------------------

    @staticmethod
    def _row(database: DatabaseSession, alert_id: str) -> AlertRow:
        row = database.get(AlertRow, alert_id)
        if row is None:
            raise NotFoundError("no_alert", f"There is no alert {alert_id[:40]}.")
        return row

    def _store(self, database: DatabaseSession, topic: AlertTopic, row: AlertRow) -> AlertView:
        database.flush()
        view = _view(row)
        for listener in self.on_change:
            listener(database, topic, view)
        return view

    def _append(
        self,
        database: DatabaseSession,
        action: str,
        view: AlertView,
        session: Session,
        detail: dict[str, str] | dict[str, float],
    ) -> None:
        entry = Entry(
            session.actor,
            action,
            "fact",
            machine_id=view.machine_id,
            detail={"alert_id": view.alert_id, "rule": view.rule.value, **detail},
        )
        self._audit.append(database, entry)

    def _publish(self, view: AlertView) -> None:
        subject = Subject(view.rule, view.machine_id)
        if view.cleared_utc is None:
            self._open[subject] = view
        elif subject in self._open and self._open[subject].alert_id == view.alert_id:
            del self._open[subject]
        self._hub.publish(AlertUpdatedEvent(alert=view))


def _view(row: AlertRow) -> AlertView:
    return AlertView.model_validate({name: getattr(row, name) for name in AlertView.model_fields})
