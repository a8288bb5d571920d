"""Alerts by e-mail through the site's SMTP server."""

import smtplib
import ssl
from collections.abc import Sequence
from email.message import EmailMessage
from typing import Any, Final
from urllib.parse import unquote, urlsplit

TIMEOUT_S: Final = 10.0
_LOCAL: Final = frozenset({"localhost", "127.0.0.1", "::1"})


def message_of(
    body: dict[str, Any], message_id: str, sender: str, to: Sequence[str]
) -> EmailMessage:
    """The e-mail about an opened alert.

    Args:
        body: of the notification (server/alerts/notification_outbox.py).
        message_id: of the notification.
        sender: address it comes from.
        to: addresses it goes to.
    """
    alert = body["data"]
    place = alert["machine_id"] or "server"
    message = EmailMessage()
    message["Subject"] = f"Downrange: {place}: {alert['rule'].replace('_', ' ')}"
    message["From"], message["To"] = sender, ", ".join(to)
    message["Message-ID"] = f"<{message_id}@downrange>"
    message.set_content(
        f"{place}: {alert['text']}\n\nSince {alert['opened_utc']}. "
        "Acknowledge it on page Alerts of the console.\n"
    )
    return message


def send_mail(url: str, message: EmailMessage) -> tuple[bool, str]:
    """Send once; whether the SMTP server took it, and what it answered in words.

    A server on another computer is spoken to by TLS: from the start (``smtps``) or by STARTTLS (``smtp``).
    """
    parts = urlsplit(url)
    host = parts.hostname or "localhost"
    context = ssl.create_default_context()
    try:
        if parts.scheme == "smtps":
            client = smtplib.SMTP_SSL(host, parts.port or 465, timeout=TIMEOUT_S, context=context)
        else:
            client = smtplib.SMTP(host, parts.port or 587, timeout=TIMEOUT_S)
        with client:
            if parts.scheme == "smtp" and host not in _LOCAL:
                client.starttls(context=context)
            if parts.username:
                client.login(unquote(parts.username), unquote(parts.password or ""))
            refused = client.send_message(message)
    except (OSError, smtplib.SMTPException) as error:
        return False, f"{type(error).__name__}: {error}"[:300]
    return True, "sent" if not refused else f"refused for {', '.join(sorted(refused))}"[:300]
