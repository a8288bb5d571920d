"""Sends what waits in the outbox: at least once, each receiver at its own pace."""

import json
import logging
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from server.alerts.mail import message_of, send_mail
from server.alerts.notification_outbox import NotificationOutbox
from server.alerts.webhook_request import WebhookAddressError, destination, send
from server.settings import Settings
from server.store.alert_models import Notification, Webhook

logger = logging.getLogger(__name__)

PERIOD_S: Final = 0.5
SENDERS_COUNT: Final = 4
HOLD_S: Final = 60.0
"""A receiver gets nothing for so long when it could not be written down what became of a message."""


class NotificationSender:
    """Looks into the outbox twice a second; a slow receiver holds up one sender, not the others."""

    def __init__(self, outbox: NotificationOutbox, settings: Settings) -> None:
        self._outbox = outbox
        self._settings = settings
        self._lock = threading.Lock()
        self._busy: set[str] = set()
        self._held_until_s: dict[str, float] = {}
        self._is_closing = threading.Event()
        self._senders = ThreadPoolExecutor(SENDERS_COUNT, "notification")
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to send."""
        self._thread = threading.Thread(target=self._run, name="notifications", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop; what was not sent is sent after the next start."""
        self._is_closing.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        self._senders.shutdown(wait=False, cancel_futures=True)

    def _run(self) -> None:
        while not self._is_closing.wait(PERIOD_S):
            try:
                self._look()
            except Exception:
                logger.exception("the outbox of notifications could not be read")

    def _look(self) -> None:
        for message, webhook in self._outbox.due():
            # One message of a receiver at a time: they arrive in order, and it is not flooded.
            receiver = message.webhook_id or "mail"
            with self._lock:
                is_held = time.monotonic() < self._held_until_s.get(receiver, 0.0)
                if is_held or receiver in self._busy:
                    continue
                self._busy.add(receiver)
            self._senders.submit(self._send, receiver, message, webhook)

    def _send(self, receiver: str, message: Notification, webhook: Webhook | None) -> None:
        try:
            is_delivered, answer = self._attempt(message, webhook)
            self._outbox.note(message.notification_id, is_delivered=is_delivered, answer=answer)
        except Exception:
            logger.exception(
                "the attempt of message %s could not be noted", message.notification_id
            )
            with self._lock:
                self._held_until_s[receiver] = time.monotonic() + HOLD_S
        finally:
            with self._lock:
                self._busy.discard(receiver)

    def _attempt(self, message: Notification, webhook: Webhook | None) -> tuple[bool, str]:
        """Send once; an error of any kind is a failed attempt."""
        try:
            return self._mail(message) if webhook is None else self._post(message, webhook)
        except Exception as error:
            # Without its text, which may hold parts of an address with a password.
            name = type(error).__name__
            logger.warning("message %s could not be sent: %s", message.notification_id, name)
            return False, name

    def _post(self, message: Notification, webhook: Webhook) -> tuple[bool, str]:
        try:
            to = destination(webhook.url, may_be_private=self._settings.webhook_private)
        except WebhookAddressError as error:
            return False, str(error)
        body = message.body.encode()
        return send(to, webhook.secret, message.notification_id, int(time.time()), body)

    def _mail(self, message: Notification) -> tuple[bool, str]:
        settings = self._settings
        if not settings.has_mail or settings.smtp_url is None:
            return False, "no e-mail is set up"
        mail = message_of(
            json.loads(message.body), message.notification_id, settings.mail_from, settings.mail_to
        )
        return send_mail(settings.smtp_url.get_secret_value(), mail)
