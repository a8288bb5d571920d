"""Tables of Zenoh keys and log channels with their rates."""

from typing import NamedTuple

KEY_ROOT = "downrange/v1"


class Key(NamedTuple):
    """A Zenoh key below the machine's prefix."""

    suffix: str
    kind: str
    """``pub``: machine to server; ``sub``: server to machine; ``query``: from the server; ``ask``: from the
    machine."""
    rate_hz: float
    """0: on demand."""
    max_bytes: int
    """Largest message of a machine that is taken, several times a usual one: a state has about 4 KiB,
    joints 0.4 KiB, a batch of 64 events 40 KiB."""
    max_rate_hz: float
    """Most messages a second that are taken of one machine; 0: not limited."""


KEYS: dict[str, Key] = {
    "alive": Key("alive", "token", 0.0, 1024, 0.0),
    "state": Key("state", "pub", 10.0, 32 * 1024, 100.0),
    "joints": Key("joints", "pub", 25.0, 4 * 1024, 100.0),
    "command": Key("command", "query", 0.0, 32 * 1024, 0.0),
    "stop": Key("stop", "sub", 10.0, 1024, 0.0),
    "heartbeat": Key("heartbeat", "sub", 20.0, 1024, 0.0),
    "events": Key("events", "ask", 0.0, 512 * 1024, 1000.0),
}


class LogChannel(NamedTuple):
    """A channel of the throw log (docs/throw_log.md)."""

    topic: str
    encoding: str
    rate_hz: float


LOG_CHANNELS: dict[str, LogChannel] = {
    "control": LogChannel("/control", "json", 100.0),
    "policy": LogChannel("/policy", "json", 12.5),
    "imu": LogChannel("/imu", "json", 100.0),
    "ball": LogChannel("/ball", "json", 50.0),
    "event": LogChannel("/event", "json", 0.0),
    "impact": LogChannel("/impact", "json", 0.0),
}


def machine_prefix(site: str, machine_id: str) -> str:
    """Key prefix of one machine."""
    return f"{KEY_ROOT}/{site}/m/{machine_id}"


def machine_key(site: str, machine_id: str, name: str) -> str:
    """Full key of a channel of one machine.

    Raises:
        KeyError: `name` is not a row of ``KEYS``.
    """
    return f"{machine_prefix(site, machine_id)}/{KEYS[name].suffix}"
