"""A yard for the kills of policy work: a server, two machines, and the network between them, all real.

Server and machines are process groups of their own; the network is a relay for HTTP and one for Zenoh.
"""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import onnx
from onnx import numpy_helper

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, file_sha256, read_policy
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner, find_policy
from runtime.policies.slots import PolicySlots
from scripts.golden_vectors import add_golden_vectors
from tests.link.relay import Relay
from tests.ports import free_port
from tests.waiting import until

ROOT = Path(__file__).parents[1]
BASE = ROOT / "policies" / "m545-2d-v7"
MODE = Mode.PLANAR
MACHINES = ("m001", "m002")
FILES = (POLICY_FILE, CARD_FILE, GOLDEN_FILE)
HTTP_DELAY_S = 0.2
"""Of each piece of data between machine and server: a transfer lasts seconds."""
START_S = 180.0


def make_version(folder: Path, number: int) -> str:
    """The active 2D version with slightly other weights; returns its sha256."""
    shutil.copytree(BASE, folder)
    model = onnx.load(str(folder / POLICY_FILE))
    for tensor in model.graph.initializer:
        if tensor.name == "weights_1":
            weights = numpy_helper.to_array(tensor) * (1.0 + 1e-5 * number)
            tensor.CopyFrom(numpy_helper.from_array(weights.astype("float32"), tensor.name))
    (folder / POLICY_FILE).write_bytes(model.SerializeToString())
    card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
    card |= {"policy_id": folder.name, "policy_sha256": file_sha256(folder / POLICY_FILE)}
    (folder / CARD_FILE).write_text(json.dumps(card), encoding="utf-8")
    (folder / GOLDEN_FILE).unlink()
    add_golden_vectors(folder)
    return str(card["policy_sha256"])


def hashes(folder: Path) -> dict[str, str]:
    """sha256 of each file of a version; without those that are not there."""
    return {
        name: sha256((folder / name).read_bytes()).hexdigest()
        for name in FILES
        if (folder / name).is_file()
    }


class Group:
    """A process group."""

    def __init__(self, log: Path, *arguments: str, **environment: str) -> None:
        with log.open("ab") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "cli.main", *arguments],
                cwd=ROOT,
                env={**os.environ, **environment, "PYTHONPATH": str(ROOT)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def kill(self) -> None:
        """As a power cut: the whole group at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class Machine:
    """`downrange machine` with the observed virtual machine."""

    def __init__(self, yard: "Yard", machine_id: str) -> None:
        self.yard, self.machine_id = yard, machine_id
        self.data = yard.folder / machine_id
        self.data.mkdir()
        self.policy_log = yard.folder / f"{machine_id}-held.jsonl"
        self.slots = PolicySlots(self.data / "policies")
        self.group: Group | None = None

    def start(self) -> None:
        """Start its processes."""
        self.group = Group(
            self.yard.folder / f"{self.machine_id}.log",
            *("machine", "--machine-id", self.machine_id, "--data", str(self.data)),
            *("--driver", "benchmarks.observed_machine:ObservedMachine"),
            *("--driver-option", f"policy_log={self.policy_log}"),
            *("--connect", self.yard.link_relay.endpoint),
            *("--server-url", f"http://127.0.0.1:{self.yard.http_relay.port}"),
            *("--policies", str(self.yard.installed), "--no-real-time"),
            *("--password-file", str(self.yard.data / "machines" / f"{self.machine_id}.password")),
        )

    def kill_child(self, name: str) -> None:
        """Kill its control or link process."""
        assert self.group is not None
        parent = self.group.process.pid
        children = Path(f"/proc/{parent}/task/{parent}/children").read_text(encoding="ascii")
        for pid in children.split():
            with contextlib.suppress(OSError):
                line = Path(f"/proc/{pid}/cmdline").read_bytes()
                if f"runtime.process.{name}_process".encode() in line:
                    os.kill(int(pid), signal.SIGKILL)

    def log(self) -> list[dict[str, Any]]:
        """What its control process has written down; a killed one may have left half a line."""
        rows: list[dict[str, Any]] = []
        for line in self.policy_log.read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(ValueError):
                rows.append(json.loads(line))
        return rows

    def problems(self) -> list[str]:
        """What is wrong with the versions on its disk; empty where every mode has one to load."""
        found: list[str] = []
        spec, trust = load_spec(), self.slots.trust()
        if trust is None:
            return [f"{self.machine_id} is bound to no site"]
        versions = self.data / "policies" / "versions"
        for folder in versions.iterdir() if versions.is_dir() else ():
            if hashes(folder) != self.yard.known.get(folder.name):
                found.append(f"{self.machine_id} has half a version {folder.name[:12]}")
        for mode in Mode:
            current = self.slots.of(mode).current
            folder = (
                self.slots.version_folder(current)
                if current
                else find_policy(self.yard.installed, mode)
            )
            try:
                files = read_policy(folder)
                trust.check(files, mode)
                PolicyRunner(files, spec)
            except PolicyError as error:
                found.append(f"{self.machine_id} cannot load its {mode.value} version: {error}")
        return found


class Yard:
    """Server, machines, network."""

    def __init__(self, folder: Path, rng: random.Random) -> None:
        self.folder, self.rng = folder, rng
        self.data = folder / "server"
        self.data.mkdir()
        self.installed = folder / "installed"
        shutil.copytree(ROOT / "policies", self.installed)
        self.port, self.link = free_port(), free_port()
        self.http_relay, self.link_relay = Relay(self.port), Relay(self.link)
        self.http_relay.delay(HTTP_DELAY_S)
        self.url = f"http://127.0.0.1:{self.port}"
        self.known: dict[str, dict[str, str]] = {}
        """Hashes of the files of each version that was made here, by its sha256."""
        self.folders: dict[str, Path] = {}
        self.server: Group | None = None
        self.client = self._new_client(self.url)
        self.start_server()
        words = (self.data / "demo-login.txt").read_text(encoding="utf-8").split()
        self.login = {"username": "admin", "password": words[words.index("admin") + 1]}
        self.client.post("/auth/login", json=self.login).raise_for_status()
        self.machines = [Machine(self, machine_id) for machine_id in MACHINES]
        for machine in self.machines:
            machine.start()

    def _new_client(self, url: str) -> httpx.Client:
        headers = {"Origin": self.url, "X-Requested-With": "downrange"}
        return httpx.Client(base_url=f"{url}/api/v1", headers=headers, timeout=60.0)

    def far_client(self) -> httpx.Client:
        """A signed-in client on the other side of the network."""
        client = self._new_client(f"http://127.0.0.1:{self.http_relay.port}")
        client.cookies.update(self.client.cookies)
        return client

    def start_server(self) -> None:
        """Start the server and wait until it answers."""
        self.server = Group(
            self.folder / "server.log",
            *("server", "--port", str(self.port), "--data", str(self.data)),
            *("--policies", str(self.installed)),
            DOWNRANGE_LINK_LISTEN=f"tcp/127.0.0.1:{self.link}",
            DOWNRANGE_PREVIEW_WORKER_COUNT="1",
            DOWNRANGE_MACHINE_SLOT_COUNT=str(len(MACHINES)),
        )
        until(self.is_up, "the server answers", START_S)

    def is_up(self) -> bool:
        """Whether the server answers."""
        try:
            return self.client.get("/health").status_code == 200
        except httpx.TransportError:
            return False

    def make_version(self) -> str:
        """Another version, on this disk only; returns its sha256."""
        number = 1 + len(self.known)
        folder = self.folder / "made" / f"made-{number}"
        found = make_version(folder, number)
        self.known[found], self.folders[found] = hashes(folder), folder
        return found

    def upload(self, policy_sha256: str, client: httpx.Client | None = None) -> httpx.Response:
        """Upload a version."""
        folder = self.folders[policy_sha256]
        parts = [("files", (name, (folder / name).read_bytes())) for name in FILES]
        data = {"reason": "for the kills"}
        return (client or self.client).post("/policies", files=parts, data=data)

    def approve(self, policy_sha256: str) -> None:
        """Approve a version without a validation."""
        body = {"reason": "for the kills", "is_without_validation": True}
        self.client.post(f"/policies/{policy_sha256}/approve", json=body).raise_for_status()

    def held(self, machine_id: str) -> str | None:
        """The 2D version that a connected machine says it has."""
        found = self.client.get(f"/machines/{machine_id}").json()
        if not found["link"]["is_connected"] or not found["state"]:
            return None
        return found["state"]["policy_sha256"].get(MODE.value)

    def stored_problems(self) -> list[str]:
        """What is wrong with the versions in the server's folder and list."""
        found: list[str] = []
        place = self.data / "uploaded-policies"
        names = {folder.name: sha for sha, folder in self.folders.items()}
        there: set[str] = set()
        for folder in place.iterdir() if place.is_dir() else ():
            if folder.name == ".incoming":
                continue
            there.add(folder.name)
            if hashes(folder) != self.known.get(names.get(folder.name, "")):
                found.append(f"the server has half a version {folder.name}")
        views = self.client.get("/policies").json()
        listed = {view["policy_id"] for view in views if view["is_present"]}
        made = {name for name in listed if name in names}
        if made != there:
            found.append(f"the server lists {sorted(made)}, on its disk are {sorted(there)}")
        return found

    def close(self) -> None:
        """End everything."""
        for machine in self.machines:
            if machine.group is not None:
                machine.group.kill()
        if self.server is not None:
            self.server.kill()
        self.http_relay.close()
        self.link_relay.close()
