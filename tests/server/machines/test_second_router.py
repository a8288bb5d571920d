"""A machine at a further router: real server, real router process, real machine processes, all encrypted."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
import trustme

from cli.main import main
from machine.errors import UsageError
from machine.messages import MachineState, ThrowState
from server.accounts.audit_chain import Actor
from server.enrolment.router_accounts import add_router
from server.store.database import upgrade
from tests.leftovers import end_with_run, has_ended
from tests.link.yard import ROOT, Machine
from tests.ports import free_port
from tests.server.hold_client import Hold
from tests.server.server_bench import Running, add_people, make_settings, running_server, wait_for

NAME = "pit-2"
TARGET = {"mode": "2d", "target": {"range_m": 6.03, "azimuth_rad": 0.0}, "rollout_count": 50}


class Router:
    """`downrange router run` in a process of its own."""

    def __init__(self, folder: Path, file: Path, certificate: Path, private_key: Path) -> None:
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        self._folder = folder
        self._arguments = [
            *(sys.executable, "-m", "cli.main", "router", "run", str(file)),
            *("--listen", self.endpoint, "--data", str(folder / NAME)),
            *("--certificate", str(certificate), "--private-key", str(private_key)),
        ]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        log = self._folder / "router.log"
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                self._arguments, cwd=ROOT, stdout=output, stderr=output, start_new_session=True
            )
        end_with_run(self._process)
        wait_for(lambda: "listens at" in log.read_text())

    def end(self, number: int = signal.SIGKILL) -> int:
        assert self._process is not None
        os.killpg(self._process.pid, number)
        code = self._process.wait(60.0)
        has_ended(self._process)
        return code


class Site:
    """Server and its router A, router B, machine m001 at B."""

    def __init__(self, running: Running, router: Router, machine: Machine) -> None:
        self.running, self.router, self.machine = running, router, machine

    def seen(self, client: httpx.Client) -> dict[str, object]:
        """What the server says of the machine."""
        return client.get("/machines/m001").json()

    def state(self, client: httpx.Client) -> str:
        found = self.seen(client)
        state = found["state"]
        return (
            state["state"] if found["link"]["is_connected"] and isinstance(state, dict) else "lost"
        )


@pytest.fixture(scope="module")
def site(swing_policies: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("site")
    authority = trustme.CA()
    issued = authority.issue_cert("127.0.0.1", common_name="console")
    root_ca, certificate, key = folder / "ca.pem", folder / "link.pem", folder / "link.key"
    authority.cert_pem.write_to_path(root_ca)
    certificate.write_bytes(b"".join(part.bytes() for part in issued.cert_chain_pems))
    issued.private_key_pem.write_to_path(key)
    link = f"tls/127.0.0.1:{free_port()}"
    encrypted = {"link_listen": link, "link_certificate": certificate, "link_private_key": key}
    addresses = {"link_address": link, "link_root_ca": root_ca}
    settings = make_settings(folder / "data", swing_policies, **encrypted, **addresses)
    settings.data_dir.mkdir()
    upgrade(settings.resolved_database_url)
    file = folder / "pit-2.json"
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        for name, value in (encrypted | addresses | {"data_dir": settings.data_dir}).items():
            patch.setenv(f"DOWNRANGE_{name.upper()}", str(value))
        add = ["router", "add", NAME, "-o", str(file)]
        running = stack.enter_context(running_server(settings))
        # The running server takes the account: the router is let in without a restart.
        assert main(add) == 0
        wait_for(lambda: running.parts.link.renewals_count)
        assert file.stat().st_mode & 0o777 == 0o600
        add_people(running.parts)
        router = Router(folder, file, certificate, key)
        router.start()
        stack.callback(router.end)
        options = {"driver": "virtual", "root-ca-file": str(root_ca)}
        machine = Machine(folder / "m001", swing_policies, router.endpoint, **options)
        machine.password_file.write_text(running.parts.registry.password("m001"))
        stack.callback(machine.end)
        machine.start()
        yield Site(running, router, machine)


@pytest.fixture
def sue(site: Site) -> Iterator[httpx.Client]:
    """Sue with control of the machine, which is disarmed and holds a load."""
    with site.running.client("sue") as client:
        wait_for(lambda: site.state(client) != "lost")
        assert client.post("/machines/m001/lease").status_code == 200
        wait_for(lambda: ready(site, client))
        yield client
        client.delete("/machines/m001/lease")


def ready(site: Site, client: httpx.Client) -> bool:
    state = site.seen(client)["state"]
    if state["stop_latched"]:
        body = {"latch_id": state["latch_id"], "is_sighted": True, "reason": "nobody is in reach"}
        client.post("/machines/m001/stop/clear", json=body)
        return False
    if not state["payload_held"]:
        client.post("/machines/m001/load")
        return False
    return state["state"] == "disarmed"


def armed_plan(site: Site, client: httpx.Client) -> str:
    plan_id = client.post("/machines/m001/plans", json=TARGET).json()["plan_id"]
    plan = wait_for(
        lambda: (plan := client.get(f"/plans/{plan_id}").json())["state"] != "previewing" and plan
    )
    assert plan["state"] == "ready", plan["refusals"]

    def arm() -> bool:
        reply = client.post(f"/plans/{plan_id}/arm", json={"plan_hash": plan["plan_hash"]})
        return reply.status_code == 200

    wait_for(arm)
    return plan_id


def fired(client: httpx.Client, plan_id: str) -> str | None:
    """Id of the throw; none where the order got too old on a busy computer. The machine is disarmed then."""
    reply = client.post(f"/plans/{plan_id}/fire")
    if reply.is_success:
        return reply.json()["throw_id"]
    assert reply.json()["error"]["code"] in ("command_stale", "not_armed"), reply.text
    client.post("/machines/m001/disarm")
    return None


def ended(client: httpx.Client, throw_id: str) -> dict[str, object]:
    def row() -> dict[str, object] | None:
        found = client.get(f"/throws/{throw_id}").json()["row"]
        return found if found["phase"] == "ended" else None

    return wait_for(row)


def thrown(site: Site, client: httpx.Client) -> dict[str, object]:
    """A throw's row; on a busy computer the test's heartbeats may come too late, and it is tried again."""
    row: dict[str, object] = {}
    for _ in range(5):
        wait_for(lambda: ready(site, client))
        plan_id = armed_plan(site, client)
        with Hold(site.running.url, client) as hold:
            hold.throw_id = fired(client, plan_id)
            if hold.throw_id is None:
                continue
            row = ended(client, hold.throw_id)
        if row["outcome"] != "aborted":
            break
    return row


def lost_alerts(client: httpx.Client, state: str) -> list[dict[str, object]]:
    return client.get("/alerts", params={"state": state, "rule": "lost"}).json()["rows"]


@pytest.mark.long
def test_a_machine_at_a_further_router_is_thrown_and_stopped(site: Site, sue: httpx.Client) -> None:
    row = thrown(site, sue)
    assert row["outcome"] == "landed", row
    assert sue.post("/machines/m001/stop").status_code == 200
    wait_for(lambda: site.state(sue) == "stopped")


def killed_in_a_throw(site: Site, client: httpx.Client) -> str:
    """Kill the router when the server sees a throw; its id. On a busy computer one may end before."""
    is_throwing = threading.Event()

    def note(_: object, state: MachineState) -> None:
        if state.state is ThrowState.THROWING:
            is_throwing.set()

    site.running.parts.registry.on_state.append(note)
    for _ in range(5):
        wait_for(lambda: ready(site, client))
        plan_id = armed_plan(site, client)
        is_throwing.clear()
        with Hold(site.running.url, client) as hold:
            throw_id = fired(client, plan_id)
            if throw_id is None:
                continue
            hold.throw_id = throw_id
            if is_throwing.wait(5.0):
                site.router.end()
                wait_for(lambda: site.state(client) == "lost")
                return throw_id
            ended(client, throw_id)
    raise AssertionError("no throw was seen to begin")


@pytest.mark.long
def test_its_router_dies_in_a_throw(site: Site, sue: httpx.Client) -> None:
    boot_id = site.seen(sue)["state"]["boot_id"]
    for _ in range(5):
        throw_id = killed_in_a_throw(site, sue)
        wait_for(lambda: lost_alerts(sue, "open"))
        site.router.start()
        wait_for(lambda: site.state(sue) == "disarmed")
        # The machine let go by itself; it completes only what was past the commit point.
        row = ended(sue, throw_id)
        if row["outcome"] != "landed":
            break
    assert row["outcome"] == "aborted", row
    state = site.seen(sue)["state"]
    assert state["payload_held"] and state["boot_id"] == boot_id
    wait_for(lambda: not lost_alerts(sue, "open"))
    armed_plan(site, sue)
    assert sue.post("/machines/m001/disarm").status_code == 200


def test_the_server_opens_its_router_anew(site: Site, sue: httpx.Client) -> None:
    renewals = site.running.parts.link.renewals_count
    boot_id = site.seen(sue)["state"]["boot_id"]
    site.running.parts.registry.enrol("m099", "", Actor("root"))
    wait_for(lambda: site.running.parts.link.renewals_count > renewals)
    wait_for(lambda: site.state(sue) == "disarmed")
    armed_plan(site, sue)
    assert site.seen(sue)["state"]["boot_id"] == boot_id
    assert sue.post("/machines/m001/disarm").status_code == 200


def test_a_router_needs_a_name_and_certificates(site: Site) -> None:
    settings = site.running.settings
    with pytest.raises(UsageError, match="is a machine"):
        add_router(settings, "m001", {"m001": "x"})
    with pytest.raises(UsageError, match="cannot be used"):
        add_router(settings, "../x", {})
    with pytest.raises(UsageError, match="DOWNRANGE_LINK_LISTEN"):
        add_router(settings.model_copy(update={"link_address": None}), "pit-3", {})
    assert not (settings.data_dir / "routers" / "pit-3.password").exists()
