"""What the browser's console said during a test."""

from playwright.sync_api import ConsoleMessage

# Said where a busy computer lets the machine answer too late.
EXPECTED = ("504 (Gateway Timeout)",)


class Console:
    """What the browser's console said."""

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.allowed: list[str] = list(EXPECTED)

    def take(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.errors.append(f"{message.text} {message.location.get('url', '')}")

    def unexpected(self) -> list[str]:
        return [e for e in self.errors if not any(allowed in e for allowed in self.allowed)]
