"""The router's passwords and rules, against a real router and real sessions."""

import stat
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme
import zenoh

from machine.channels import KEYS, machine_key
from machine.errors import UsageError
from runtime.link.zenoh_config import RouterTls, Upstream, client_config, router_config
from tests.cases import each
from tests.ports import free_port
from tests.waiting import wait_for

SITE = "yard"
USERS = {"m001": "one", "m002": "two", "server": "three"}


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def router(tmp_path: Path, endpoint: str) -> Iterator[zenoh.Session]:
    config = router_config(
        listen=[endpoint],
        users=USERS,
        machines=["m001", "m002"],
        site=SITE,
        dictionary_file=tmp_path / "users.txt",
    )
    with zenoh.open(config) as session:
        yield session


def key(machine_id: str, name: str) -> str:
    return machine_key(SITE, machine_id, name)


def listen(session: zenoh.Session, name: str, seen: list[str]) -> None:
    """Every machine's channel by its own key, as the server does.

    A wildcard is not announced to machines, whose rules cover their own keys only; what they put is kept back
    as soon as they know that nobody listens. On a busy computer that is before their first put.
    """
    for machine_id in ("m001", "m002"):
        session.declare_subscriber(key(machine_id, name), lambda s: seen.append(str(s.key_expr)))


@each(
    ("user", "password"),
    [("m001", "wrong"), ("nobody", "one"), (None, None), ("m001", "two")],
)
def test_wrong_credentials_are_refused(router, endpoint, user, password) -> None:
    with pytest.raises(zenoh.ZError):
        zenoh.open(client_config(connect=[endpoint], user=user, password=password))


class Site:
    """A router that listens on TLS with a certificate of the site's own authority."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        authority = trustme.CA()
        self.authority = folder / "ca.pem"
        authority.cert_pem.write_to_path(self.authority)
        issued = authority.issue_cert("127.0.0.1", common_name="console")
        certificate, private_key = folder / "router.pem", folder / "router.key"
        certificate.write_bytes(b"".join(part.bytes() for part in issued.cert_chain_pems))
        issued.private_key_pem.write_to_path(private_key)
        self.tls = RouterTls(certificate, private_key)

    def router(self, endpoint: str) -> zenoh.Session:
        return zenoh.open(
            router_config(
                listen=[endpoint],
                users=USERS,
                machines=["m001", "m002"],
                site=SITE,
                dictionary_file=self.folder / "users.txt",
                tls=self.tls,
            )
        )


def test_an_encrypted_link_takes_its_own_machines_and_nobody_else(tmp_path, endpoint) -> None:
    site = Site(tmp_path)
    encrypted = endpoint.replace("tcp/", "tls/")
    foreign = tmp_path / "foreign.pem"
    trustme.CA().cert_pem.write_to_path(foreign)
    with site.router(encrypted) as router:
        states: list[str] = []
        router.declare_subscriber(key("m001", "state"), lambda s: states.append(str(s.key_expr)))
        config = client_config(
            connect=[encrypted], user="m001", password="one", root_ca_file=site.authority
        )
        with zenoh.open(config) as machine:
            publisher = machine.declare_publisher(key("m001", "state"))
            assert wait_for(lambda: publisher.put(b"{}") or states, 20.0)
        for refused in (
            {"connect": [encrypted], "password": "wrong", "root_ca_file": site.authority},
            {"connect": [encrypted], "password": "one", "root_ca_file": foreign},
            {"connect": [encrypted], "password": "one"},
            {"connect": [endpoint], "password": "one"},
        ):
            with pytest.raises(zenoh.ZError):
                zenoh.open(client_config(user="m001", **refused))


@each("common_name", ["console", "another"])
def test_a_further_router_obeys_the_server_that_it_knows(tmp_path, endpoint, common_name) -> None:
    site = Site(tmp_path)
    encrypted = f"tls/127.0.0.1:{free_port()}"
    config = router_config(
        listen=[endpoint],
        users={"m001": "one", "m002": "two"},
        machines=["m001", "m002"],
        site=SITE,
        dictionary_file=tmp_path / "further.txt",
        upstream=Upstream(encrypted, "server", "three", common_name, site.authority),
    )
    stolen: list[str] = []
    with (
        site.router(encrypted) as router,
        zenoh.open(config),
        zenoh.open(client_config(connect=[endpoint], user="m001", password="one")) as machine,
        zenoh.open(client_config(connect=[endpoint], user="m002", password="two")) as other,
    ):
        asked = key("m001", "command")
        machine.declare_queryable(asked, lambda q: q.reply(q.key_expr, b"own"))
        other.declare_queryable(key("*", "command"), lambda q: q.reply(q.key_expr, b"spoof"))
        other.declare_subscriber("downrange/**", lambda s: stolen.append(str(s.key_expr)))

        def ask(by: zenoh.Session) -> list[bytes]:
            return [bytes(r.ok.payload) for r in by.get(asked, timeout=1.0) if r.ok]

        if common_name == "console":
            assert wait_for(lambda: ask(router), 20.0) == [b"own"]
            router.put(key("m001", "heartbeat"), b"secret")
            assert ask(router) == [b"own"]
        else:
            assert wait_for(lambda: router.info.routers_zid(), 20.0)
            assert ask(router) == []
        # A session hears itself without a router.
        assert ask(other) == [b"spoof"]
        assert stolen == []


def test_password_file_is_private(router, tmp_path) -> None:
    assert stat.S_IMODE((tmp_path / "users.txt").stat().st_mode) == 0o600


def test_machine_speaks_for_itself(router, endpoint) -> None:
    states: list[str] = []
    alive: list[str] = []
    listen(router, "state", states)
    router.liveliness().declare_subscriber(
        key("*", "alive"), lambda s: alive.append(str(s.key_expr)), history=True
    )
    with zenoh.open(client_config(connect=[endpoint], user="m001", password="one")) as machine:
        token = machine.liveliness().declare_token(key("m001", "alive"))
        publisher = machine.declare_publisher(key("m001", "state"))
        # A put before the subscription has travelled to the publisher is not kept for it.
        assert wait_for(lambda: publisher.put(b"{}") or (states and alive), 20.0)
        token.undeclare()
    assert set(states) == {key("m001", "state")}
    assert set(alive) == {key("m001", "alive")}


def test_machine_cannot_speak_or_listen_for_another(router, endpoint) -> None:
    seen: list[str] = []
    stolen: list[str] = []
    for name in ("state", "joints"):
        listen(router, name, seen)
    router.liveliness().declare_subscriber(
        key("*", "alive"), lambda s: seen.append(str(s.key_expr)), history=True
    )
    with zenoh.open(client_config(connect=[endpoint], user="m001", password="one")) as machine:
        machine.liveliness().declare_token(key("m002", "alive"))
        machine.declare_queryable(key("m002", "command"), lambda q: q.reply(q.key_expr, b"spoof"))
        machine.declare_queryable(key("*", "command"), lambda q: q.reply(q.key_expr, b"spoof"))
        for name in (key("m002", "heartbeat"), key("*", "heartbeat"), "downrange/**"):
            machine.declare_subscriber(name, lambda s: stolen.append(str(s.key_expr)))
        machine.declare_queryable(key("m001", "command"), lambda q: q.reply(q.key_expr, b"own"))
        machine.put(key("m002", "state"), b"spoof")
        # The own reply comes after the spoofed declarations on the same link: they have been judged by then.
        assert wait_for(
            lambda: (
                [bytes(r.ok.payload) for r in router.get(key("m001", "command"), timeout=1.0)]
                == [b"own"]
            )
        )
        router.put(key("m002", "heartbeat"), b"secret")
        assert not list(router.get(key("m002", "command"), timeout=0.3))
        assert wait_for(
            lambda: machine.put(key("m001", "joints"), b"last") or key("m001", "joints") in seen
        )
        assert not [name for name in seen if "m002" in name]
        # A session hears its own puts without the router; only what the router sent would be stolen.
        assert key("m002", "heartbeat") not in stolen


def test_outside_server_reaches_all_machines(router, endpoint) -> None:
    with (
        zenoh.open(client_config(connect=[endpoint], user="m002", password="two")) as machine,
        zenoh.open(client_config(connect=[endpoint], user="server", password="three")) as server,
    ):
        machine.declare_queryable(key("m002", "command"), lambda q: q.reply(q.key_expr, b"yes"))
        assert wait_for(
            lambda: (
                [bytes(r.ok.payload) for r in server.get(key("m002", "command"), timeout=1.0)]
                == [b"yes"]
            )
        )


@each("name", ["", "a/b", "a:b", "A", "*", "m$1", "x" * 33])
def test_unusable_machine_ids(tmp_path, name) -> None:
    with pytest.raises(UsageError):
        router_config(
            listen=[],
            users={name: "x"},
            machines=[name],
            site="yard",
            dictionary_file=tmp_path / "u",
        )


@each("users", [{}, {"m001": ""}, {"m001": "a:b"}, {"m001": "a\nserver:x"}])
def test_unusable_passwords(tmp_path, users) -> None:
    with pytest.raises(UsageError):
        router_config(
            listen=[], users=users, machines=["m001"], site="yard", dictionary_file=tmp_path / "u"
        )


def test_a_machine_sends_no_more_than_its_share(router, endpoint) -> None:
    sizes: list[int] = []
    router.declare_subscriber(key("m001", "state"), lambda s: sizes.append(len(s.payload)))
    limit = KEYS["state"].max_bytes
    with zenoh.open(client_config(connect=[endpoint], user="m001", password="one")) as machine:
        publisher = machine.declare_publisher(key("m001", "state"))
        assert wait_for(lambda: publisher.put(b"{}") or sizes, 20.0)
        for size in (limit + 1024, 2 * 1024 * 1024, 17 * 1024 * 1024):
            publisher.put(bytes(size))
        sizes.clear()
        began_s = time.monotonic()
        for _ in range(2000):
            publisher.put(b"x")
        time.sleep(0.05)
        # The last one is let through after the flood: the link itself still stands.
        assert wait_for(lambda: publisher.put(b"last") or 4 in sizes, 20.0)
        seconds = time.monotonic() - began_s
    assert max(sizes) <= limit
    assert len(sizes) <= 2 + KEYS["state"].max_rate_hz * seconds * 1.5
