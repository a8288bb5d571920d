"""A small yard for the fault suite: a real router, a stand-in for the server, real machine processes."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import uuid
from pathlib import Path
from typing import Any

import zenoh

from machine.channels import machine_key
from machine.conventions import Mode
from machine.messages import (
    ArmRequest,
    Command,
    CommandReply,
    DisarmRequest,
    EventAck,
    EventBatch,
    FireRequest,
    LeaseNotice,
    LoadRequest,
    MachineEvent,
    MachineState,
    OperatorHeartbeat,
    StopClearRequest,
    StopRequest,
    Target,
    ThrowPlan,
    ThrowState,
)
from machine.policy_card import load_card
from machine.spec import load_spec
from runtime.control.policy import find_policy
from runtime.link.zenoh_config import router_config
from tests.leftovers import end_with_run, has_ended
from tests.link.relay import Relay
from tests.ports import free_port
from tests.waiting import wait_for

SITE = "yard"
MACHINE = "m001"
PASSWORD = "rust-and-oil"
ROOT = Path(__file__).parents[2]


class Server:
    """What the fault suite needs of a server: commands out; states, events and tokens in."""

    def __init__(self, folder: Path, port: int, lease_ms: int = 1000) -> None:
        self._config = router_config(
            listen=[f"tcp/127.0.0.1:{port}"],
            users={MACHINE: PASSWORD, "m002": "other"},
            machines=[MACHINE, "m002"],
            site=SITE,
            dictionary_file=folder / "users.txt",
            lease_ms=lease_ms,
        )
        self.states: list[MachineState] = []
        self.events: list[MachineEvent] = []
        self.repeats = 0
        self.joints_ns = 0
        self.is_alive = False
        self.acks_lost = 0
        """Acknowledgements still to be lost after the commit."""
        self._seen: set[tuple[str, int]] = set()
        self._session: zenoh.Session | None = None
        self.holding: threading.Event | None = None
        self.open()

    def open(self) -> None:
        session = self._session = zenoh.open(self._config)
        self._declared = [
            session.declare_subscriber(self._key("state"), self._take_state),
            session.declare_subscriber(self._key("joints"), self._take_joints),
            session.declare_queryable(self._key("events"), self._take_events),
            session.liveliness().declare_subscriber(
                self._key("alive"), self._take_token, history=True
            ),
        ]

    def close(self) -> None:
        if self._session is not None:
            for declared in self._declared:
                declared.undeclare()
            self._session.close()
            self._session = None

    def _key(self, name: str) -> str:
        return machine_key(SITE, MACHINE, name)

    def _take_state(self, sample: zenoh.Sample) -> None:
        state = MachineState.model_validate_json(bytes(sample.payload))
        if self.states and self.states[-1].boot_id != state.boot_id:
            self.joints_ns = 0
        self.states.append(state)

    def _take_joints(self, sample: zenoh.Sample) -> None:
        self.joints_ns = json.loads(bytes(sample.payload))["t_mono_ns"]

    def _take_token(self, sample: zenoh.Sample) -> None:
        self.is_alive = sample.kind == zenoh.SampleKind.PUT

    def _take_events(self, query: zenoh.Query) -> None:
        batch = EventBatch.model_validate_json(bytes(query.payload))
        for event in batch.events:
            key = (event.boot_id, event.sequence_count)
            if key in self._seen:
                self.repeats += 1
            else:
                self._seen.add(key)
                self.events.append(event)
        with query:
            if self.acks_lost > 0:
                self.acks_lost -= 1
                return
            ack = EventAck(boot_id=batch.boot_id, sequence_count=batch.events[-1].sequence_count)
            query.reply(query.key_expr, ack.model_dump_json())

    # Speaking -------------------------------------------------------------------------------------

    @property
    def state(self) -> MachineState:
        return self.states[-1]

    def seen(self) -> dict[str, int]:
        """The newest time of the machine that came in."""
        return {"seen_t_mono_ns": max(self.state.t_mono_ns, self.joints_ns)}

    def clear(self, epoch: int) -> CommandReply | None:
        """Clear whatever is latched."""
        return self.order(
            StopClearRequest,
            epoch_count=epoch,
            latch_id=self.state.latch_id,
            sighted_by="olga",
            reason="nobody near",
            **self.seen(),
        )

    def send(self, command: Command, timeout_s: float = 20.0) -> CommandReply | None:
        replies = self._session.get(
            self._key("command"), payload=command.model_dump_json(), timeout=timeout_s
        )
        answers = [bytes(reply.ok.payload) for reply in replies if reply.ok is not None]
        assert len(answers) <= 1
        return CommandReply.model_validate_json(answers[0]) if answers else None

    def ask(self, payload: bytes) -> bytes:
        """Any payload as a command; the one answer."""
        replies = self._session.get(self._key("command"), payload=payload, timeout=20.0)
        (answer,) = [bytes(reply.ok.payload) for reply in replies]
        return answer

    def order(self, kind: type[Any], **fields: Any) -> CommandReply | None:
        return self.send(make(kind, **fields))

    def put(self, name: str, text: str) -> None:
        self._session.put(self._key(name), text, express=True)

    def wait_state(self, *wanted: ThrowState, timeout_s: float = 60.0) -> MachineState:
        known = len(self.states)
        return wait_for(
            lambda: next((s for s in self.states[known:] if s.state in wanted), None), timeout_s
        )

    def kinds(self, throw_id: str | None = None) -> list[str]:
        return [e.kind.value for e in self.events if throw_id in (None, e.throw_id)]

    def ends(self, throw_id: str) -> list[str]:
        return [
            e.data["outcome"]
            for e in self.events
            if e.kind == "throw_ended" and e.throw_id == throw_id
        ]

    # A throw --------------------------------------------------------------------------------------

    def arm(self, plan: ThrowPlan, epoch: int) -> str:
        """Lease, load, arm; returns the nonce."""
        assert self.order(LeaseNotice, epoch_count=epoch).accepted
        wait_for(
            lambda: (
                (reply := self.order(LoadRequest, epoch_count=epoch, **self.seen()))
                and reply.accepted
            )
        )
        wait_for(lambda: self.state.payload_held)

        def try_to_arm() -> str | None:
            reply = self.order(ArmRequest, epoch_count=epoch, plan=plan, **self.seen())
            return reply and reply.nonce

        return wait_for(try_to_arm)

    def fire_command(self, plan: ThrowPlan, nonce: str, throw_id: str, epoch: int):
        return make(
            FireRequest,
            epoch_count=epoch,
            throw_id=throw_id,
            nonce=nonce,
            plan_hash=plan.plan_hash,
            **self.seen(),
        )

    def hold_button(self, throw_id: str, epoch: int) -> None:
        """20 Hz until `let_go` or `go_silent`."""
        self.holding = threading.Event()

        def beat(stop: threading.Event) -> None:
            sequence = 0
            while not stop.wait(0.05):
                sequence += 1
                message = OperatorHeartbeat(
                    machine_id=MACHINE,
                    throw_id=throw_id,
                    epoch_count=epoch,
                    sequence_count=sequence,
                    is_holding=True,
                    **self.seen(),
                )
                with contextlib.suppress(zenoh.ZError, AttributeError):
                    self.put("heartbeat", message.model_dump_json())

        self._beats = threading.Thread(target=beat, args=(self.holding,), daemon=True)
        self._beats.start()

    def go_silent(self) -> None:
        if self.holding is not None:
            self.holding.set()
            self._beats.join(2.0)
            self.holding = None

    def stop_command(self) -> StopRequest:
        return make(StopRequest)


def make(kind: type[Any], **fields: Any) -> Any:
    return kind(command_id=uuid.uuid4().hex, machine_id=MACHINE, issuer="operator", **fields)


def make_plan(policies: Path, mode: Mode = Mode.PLANAR) -> ThrowPlan:
    spec = load_spec()
    return ThrowPlan(
        plan_id="plan-1",
        machine_id=MACHINE,
        mode=mode,
        target=Target(x_m=8.0, y_m=spec.geometry.arm_plane_offset_m),
        policy_sha256=load_card(find_policy(policies, mode)).policy_sha256,
        model_sha256=spec.sha256,
        twin_profile_version=0,
        predicted_impact_m=(8.0, 0.0, 0.0),
        allowed_radius_m=20.0,
    )


class Machine:
    """`downrange machine` with the fake driver, in processes of its own."""

    def __init__(self, folder: Path, policies: Path, endpoint: str, **options: str) -> None:
        self.folder = folder
        self._policies = policies
        self._endpoint = endpoint
        self._options = options
        folder.mkdir(exist_ok=True)
        self.password_file = folder / "password.txt"
        self.password_file.write_text(PASSWORD, encoding="utf-8")
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        environment = dict(os.environ)
        environment["PYTHONPATH"] = str(ROOT)
        options = {"driver": "tests.runtime.fake_driver:FakeDriver", **self._options}
        self.process = subprocess.Popen(
            [
                sys.executable, "-m", "cli.main", "machine", "--machine-id", MACHINE,
                "--site", SITE, "--data", str(self.folder), "--policies", str(self._policies),
                "--connect", self._endpoint, "--password-file", str(self.password_file),
                "--no-real-time",
                *(text for name, value in options.items() for text in (f"--{name}", value)),
            ],
            env=environment,
            cwd=ROOT,
            start_new_session=True,
        )  # fmt: skip
        end_with_run(self.process)

    def child(self, module: str) -> int:
        """Process id of `runtime.process.control_process` or `runtime.process.link_process`."""

        def find() -> int | None:
            children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
            for pid in children.read_text(encoding="ascii").split():
                line = Path(f"/proc/{pid}/cmdline").read_bytes()
                if module.encode() in line:
                    return int(pid)
            return None

        return wait_for(find)

    def kill_child(self, module: str, number: int = signal.SIGKILL) -> None:
        os.kill(self.child(module), number)

    def kill(self) -> None:
        """Power off: supervisor and children at once."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        has_ended(self.process)

    def stop(self, timeout_s: float = 30.0) -> int:
        """SIGTERM; returns the exit code."""
        if self.process.poll() is None:
            self.process.terminate()
        return self.process.wait(timeout_s)

    def end(self) -> None:
        """Whatever is left of it, gone."""
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            has_ended(self.process)


class Yard:
    """One server, one relay, one machine, for several tests: epochs and throw ids are never reused."""

    def __init__(self, folder: Path, policies: Path, lease_ms: int = 1000) -> None:
        port = free_port()
        self.server = Server(folder, port, lease_ms)
        self.relay = Relay(port)
        self.machine = Machine(folder / MACHINE, policies, self.relay.endpoint)
        self.plan = make_plan(policies)
        self.epoch = 0
        self._throw_count = 0

    def close(self) -> None:
        self.machine.end()
        self.server.go_silent()
        self.server.close()
        self.relay.close()

    def ready(self) -> None:
        """The machine runs, is connected and disarmed."""
        self.relay.mend()
        self.relay.heal()
        self.relay.delay(0.0)
        self.server.go_silent()
        if self.machine.process is None or self.machine.process.poll() is not None:
            self.machine.start()
        wait_for(lambda: self.server.is_alive and self.server.states)
        self.epoch += 1
        # The test before may have killed a process of the machine: until it is back it does not accept.
        wait_for(lambda: self._is_accepted(LeaseNotice))
        wait_for(lambda: (reply := self.server.clear(self.epoch)) and reply.accepted)
        self.server.wait_state(ThrowState.DISARMED)

    def _is_accepted(self, kind: type[Any]) -> bool:
        reply = self.server.order(kind, epoch_count=self.epoch)
        return reply is not None and reply.accepted

    def new_throw_id(self) -> str:
        self._throw_count += 1
        return f"throw-{self._throw_count}"

    def arm(self) -> str:
        return self.server.arm(self.plan, self.epoch)

    def fire_command(self, nonce: str, throw_id: str) -> Any:
        return self.server.fire_command(self.plan, nonce, throw_id, self.epoch)

    def fire(self) -> str:
        """Arm, fire, hold; returns the throw's id. On a busy computer a fire may get too old on its way."""

        def try_to_fire() -> str | None:
            nonce, throw_id = self.arm(), self.new_throw_id()
            reply = self.server.send(self.fire_command(nonce, throw_id))
            if reply is not None and reply.accepted:
                return throw_id
            assert reply is None or reply.reason in ("command_stale", "not_armed"), reply
            self.server.order(DisarmRequest, epoch_count=self.epoch)
            self.server.wait_state(ThrowState.DISARMED)
            return None

        throw_id = wait_for(try_to_fire)
        self.server.hold_button(throw_id, self.epoch)
        return throw_id

    def fire_until(self, event: str) -> str:
        """A throw that has reached this event and still runs.

        On a busy computer the test's own heartbeats may come too late; the machine then lets go, as it
        must, and the throw is tried again.
        """
        for _ in range(5):
            throw_id = self.fire()
            wait_for(lambda t=throw_id: {event, "throw_ended"} & set(self.server.kinds(t)))
            if "aborted" not in self.server.kinds(throw_id):
                return throw_id
            self.server.go_silent()
            self.server.wait_state(ThrowState.DISARMED)
        raise AssertionError(
            "five throws in a row lost their heartbeats: this computer is too busy"
        )

    def wait_for_log(self, throw_id: str) -> None:
        wait_for(lambda: "log_stored" in self.server.kinds(throw_id))

    def log_path(self, throw_id: str) -> Path:
        return self.machine.folder / "throws" / f"{throw_id}.mcap"
