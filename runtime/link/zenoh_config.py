"""Zenoh configurations of both ends of the link: a router that knows its machines, and its clients.

One function each, so that server, machine and tests cannot drift apart. No discovery of any kind: endpoints
are explicit, users have passwords, and a machine can neither speak nor listen outside its own keys.
"""

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from machine.channels import KEY_ROOT, KEYS, machine_key, machine_prefix
from machine.errors import UsageError

LEASE_MS = 1000
"""Silence after which an end gives its peer up; measured: a frozen machine is seen after 0.76 s."""
KEEP_ALIVE_COUNT = 4
"""Keep-alive messages a lease: one may be late or lost without harm (ITU-T G.8013 asks for 3.5)."""
RETRY_MIN_MS = 200
RETRY_MAX_MS = 1000
OPEN_TIMEOUT_MS = 1000
"""Bound of one attempt to open a client session; the caller tries again."""

MAX_MESSAGE_BYTES = 1024 * 1024
"""Most that the router puts together from the fragments of one message; every key has a lower bound."""

NAME_PATTERN = re.compile(r"^[a-z0-9][a-z0-9_-]{0,31}$")
"""Sites, machine ids, user names: one chunk of a key; no wildcard, no ':' (it ends a dictionary name)."""

_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


@dataclass(frozen=True, slots=True)
class RouterTls:
    """Files of a router that listens on ``tls/...``, PEM. Machines prove themselves by their passwords."""

    certificate: Path
    private_key: Path


@dataclass(frozen=True, slots=True)
class Upstream:
    """The server's router, as a further router of the site reaches it.

    Zenoh gives the end that was connected to no user name; a further router knows it by its certificate.
    """

    endpoint: str
    """``tls/HOST:PORT``."""
    user: str
    password: str
    common_name: str
    """Subject's common name in the certificate of `endpoint`."""
    root_ca_file: Path
    """Authority of that certificate, PEM."""


def check_name(what: str, name: str) -> str:
    """Return `name` if it can be one chunk of a key and a user name.

    Raises:
        UsageError: it cannot.
    """
    if not NAME_PATTERN.match(name):
        raise UsageError(
            f"{what} {name!r} cannot be used: 1 to 32 of a-z 0-9 _ - and not first a sign"
        )
    return name


def router_config(
    *,
    listen: Sequence[str],
    users: Mapping[str, str],
    machines: Iterable[str],
    site: str,
    dictionary_file: Path,
    tls: RouterTls | None = None,
    upstream: Upstream | None = None,
    lease_ms: int = LEASE_MS,
) -> zenoh.Config:
    """Configuration of a router: passwords, and one rule a machine.

    Args:
        listen: Endpoints, e.g. ``("tcp/127.0.0.1:7447",)``.
        users: User name -> password. Those who are not in `machines` are servers and may do everything
            below ``downrange/v1``; the session that is the router itself needs no user.
        machines: Machine ids; each is also the user name under which the machine connects.
        site: Site of these machines.
        dictionary_file: Where the passwords are written for Zenoh, mode 0600.
        tls: Needed for ``tls/...`` endpoints.
        upstream: For a further router: the server's router, which it calls in at and lets do everything.
        lease_ms: What the router announces; machines notice a dead router after this time.

    Raises:
        UsageError: a name that cannot be used, or a machine without a password.
    """
    machine_ids = [check_name("machine id", name) for name in machines]
    check_name("site", site)
    missing = [name for name in machine_ids if name not in users]
    if missing:
        raise UsageError(
            f"no password for {', '.join(missing)}: every machine needs one in `users`"
        )
    _write_dictionary(dictionary_file, users)
    servers = [name for name in users if name not in set(machine_ids)]
    config = _common(lease_ms)
    config["mode"] = "router"
    # Nothing is searched for: without this the session opens half a second after the port does.
    config["scouting"]["delay"] = 0
    config["listen"] = {"endpoints": list(listen), "exit_on_failure": True}
    accounts: dict[str, str] = {"dictionary_file": str(dictionary_file)}
    link_tls: dict[str, object] = {}
    if tls is not None:
        link_tls["listen_certificate"] = str(tls.certificate)
        link_tls["listen_private_key"] = str(tls.private_key)
        link_tls["close_link_on_expiration"] = True
    if upstream is not None:
        accounts |= {"user": upstream.user, "password": upstream.password}
        link_tls["root_ca_certificate"] = str(upstream.root_ca_file)
        config["connect"] = {
            "endpoints": [upstream.endpoint],
            # Its machines may call in before the server does; it goes on trying.
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": _retry(),
        }
    config["transport"]["auth"] = {"usrpwd": accounts}
    config["access_control"] = _access_control(site, machine_ids, servers, upstream)
    config["transport"]["link"]["rx"] = {"max_message_size": MAX_MESSAGE_BYTES}
    config["low_pass_filter"] = _size_limits(site)
    config["downsampling"] = _rate_limits(site, machine_ids)
    if link_tls:
        config["transport"]["link"]["tls"] = link_tls
    return _built(config)


def client_config(
    *,
    connect: Sequence[str],
    user: str | None = None,
    password: str | None = None,
    root_ca_file: Path | None = None,
    lease_ms: int = LEASE_MS,
) -> zenoh.Config:
    """Configuration of a machine's (or an outside server's) session.

    With `root_ca_file` (PEM) ``tls/...`` endpoints must show a certificate of that authority.
    `zenoh.open` raises within about a second when no endpoint can be reached or the router refuses the
    password (it does not say which); the caller tries again. Once open, Zenoh reconnects by itself.
    """
    config = _common(lease_ms)
    config["mode"] = "client"
    config["connect"] = {
        "endpoints": list(connect),
        "timeout_ms": OPEN_TIMEOUT_MS,
        "exit_on_failure": False,
        "retry": _retry(),
    }
    if user is not None:
        config["transport"]["auth"] = {"usrpwd": {"user": user, "password": password or ""}}
    if root_ca_file is not None:
        config["transport"]["link"]["tls"] = {"root_ca_certificate": str(root_ca_file)}
    return _built(config)


def _retry() -> dict[str, int]:
    return {
        "period_init_ms": RETRY_MIN_MS,
        "period_max_ms": RETRY_MAX_MS,
        "period_increase_factor": 2,
    }


def _common(lease_ms: int) -> dict[str, Any]:
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {"tx": {"lease": lease_ms, "keep_alive": KEEP_ALIVE_COUNT}},
        },
    }


def _access_control(
    site: str, machines: list[str], servers: list[str], upstream: Upstream | None
) -> dict[str, Any]:
    rules = [_rule(name, f"{machine_prefix(site, name)}/**") for name in machines]
    subjects = [{"id": name, "usernames": [name]} for name in machines]
    policies = [{"rules": [name], "subjects": [name]} for name in machines]
    trusted: list[dict[str, Any]] = []
    # Machine ids are lower case, so these names cannot be one of theirs.
    if servers:
        trusted.append({"id": "Servers", "usernames": servers})
    if upstream is not None:
        trusted.append({"id": "Upstream", "cert_common_names": [upstream.common_name]})
    if trusted:
        rules.append(_rule("Servers", f"{KEY_ROOT}/**"))
        subjects += trusted
        policies += [{"rules": ["Servers"], "subjects": [one["id"]]} for one in trusted]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _size_limits(site: str) -> list[dict[str, Any]]:
    """What a machine may send at most, by key; larger messages are dropped before anybody sees them."""
    return [
        {
            "id": f"size-{name}",
            "flows": ["ingress"],
            "messages": ["put", "delete", "query", "reply"],
            "key_exprs": [machine_key(site, "*", name)],
            "size_limit": key.max_bytes,
        }
        for name, key in KEYS.items()
    ]


def _rate_limits(site: str, machines: list[str]) -> list[dict[str, Any]]:
    """How often a machine may send; a rule a machine, because the messages under one rule share its rate."""
    limited = [(name, key) for name, key in KEYS.items() if key.max_rate_hz > 0.0]
    if not machines:
        return []
    return [
        {
            "id": f"rate-{name}",
            "flows": ["ingress"],
            "messages": ["query" if key.kind == "ask" else "put"],
            "rules": [
                {"key_expr": machine_key(site, machine_id, name), "freq": key.max_rate_hz}
                for machine_id in machines
            ],
        }
        for name, key in limited
    ]


def _rule(name: str, key: str) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": list(_MESSAGES),
        "key_exprs": [key],
    }


def _write_dictionary(path: Path, users: Mapping[str, str]) -> None:
    for name, password in users.items():
        check_name("user", name)
        if not password or "\n" in password or ":" in password:
            raise UsageError(f"the password of {name} is empty or holds ':' or a line break")
    text = "".join(f"{name}:{password}\n" for name, password in users.items())
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        os.fchmod(file.fileno(), 0o600)
        file.write(text)


def _built(config: dict[str, Any]) -> zenoh.Config:
    return zenoh.Config.from_json5(json.dumps(config))
