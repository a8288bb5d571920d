"""The example in docs/drivers.md runs under the real control step, against a stand-in controller."""

import importlib.util
import re
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from machine.conventions import CONTROL_PERIOD_NS
from machine.errors import UsageError
from machine.messages import StopRequest, ThrowState
from machine.starts import safe_pose
from runtime.driver import Driver
from runtime.process.driver_loader import load_driver
from tests.cases import each
from tests.ports import free_port
from tests.runtime.machine_bench import Bench, make

DOCUMENT = Path(__file__).parents[2] / "docs/drivers.md"
SENSORS = struct.Struct("<4f4f3f3fH")
VALVES = struct.Struct("<4f2Bq")


class Controller:
    """The machine's own controller: UDP in and out, when the test says so."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(30.0)
        self.driver_port = free_port(socket.SOCK_DGRAM)
        self.joints = [float(value) for value in safe_pose()[:4]]
        self.switches = 3

    @property
    def options(self) -> dict[str, str]:
        return {
            "address": f"127.0.0.1:{self.socket.getsockname()[1]}",
            "listen": f"127.0.0.1:{self.driver_port}",
        }

    def send(self) -> None:
        motion = (0.0,) * 7 + (0.0, 0.0, 9.81)
        datagram = SENSORS.pack(*self.joints, *motion, self.switches)
        self.socket.sendto(datagram, ("127.0.0.1", self.driver_port))

    def valves(self) -> tuple[float, ...]:
        return VALVES.unpack(self.socket.recv(64))


@pytest.fixture
def controller() -> Iterator[Controller]:
    controller = Controller()
    yield controller
    controller.socket.close()


@pytest.fixture(scope="module")
def module_name(tmp_path_factory) -> Iterator[str]:
    """The document's code as an importable module."""
    (code,) = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.S)
    path = tmp_path_factory.mktemp("driver") / "yard_udp.py"
    path.write_text(code, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(path.parent))
        assert importlib.util.find_spec("yard_udp") is not None
        yield "yard_udp:YardMachine"


def open_driver(module_name: str, controller: Controller, monkeypatch) -> Driver:
    # The controller's first datagram waits in the socket before the driver looks for it.
    original = socket.socket.settimeout

    def send_first(end: socket.socket, timeout_s: float | None) -> None:
        original(end, timeout_s)
        controller.send()

    with monkeypatch.context() as patch:
        patch.setattr(socket.socket, "settimeout", send_first)
        return load_driver(module_name, controller.options, 0)


def test_example_runs_under_the_control_step(module_name, controller, quick_policies, monkeypatch):
    driver = open_driver(module_name, controller, monkeypatch)
    # Time goes on by ticks, not by how busy the computer is that tests: late samples stop a machine.
    now_ns = driver.now_ns()
    monkeypatch.setattr(driver, "now_ns", lambda: now_ns)
    bench = Bench(quick_policies, driver)
    counts = []
    for _ in range(30):
        now_ns += CONTROL_PERIOD_NS
        controller.send()
        bench.tick()
        *ratios, gripper, supply, alive_count = controller.valves()
        assert np.abs(ratios).max() <= 1.0
        assert (gripper, supply) == (0, 1)
        counts.append(alive_count)
    assert np.diff(counts).tolist() == [1] * 29
    state = bench.control.machine_state()
    assert state.state is ThrowState.DISARMED
    assert state.payload_held
    assert state.joint_position_rad_m[:4] == pytest.approx(controller.joints, abs=1e-6)
    failed = {check.check_id for check in state.checks if not check.passed}
    assert failed <= {"calibration", "gripper_swing", "control_loop"}
    controller.switches = 3 | 4
    controller.send()
    bench.tick()
    assert bench.control.throw.state is ThrowState.STOPPED
    assert bench.ask(make(StopRequest)).accepted
    bench.control.close()
    sent = [controller.valves() for _ in range(4)]
    # Stopped: the controller is to cut the supply. Closed: it stays cut.
    assert [one[5] for one in sent[:2]] == [0, 0]
    assert sent[-1][:6] == (0.0, 0.0, 0.0, 0.0, 0, 0)


def test_example_unwraps_the_slew_angle(module_name, controller, monkeypatch):
    driver = open_driver(module_name, controller, monkeypatch)
    seen = []
    for slew in np.linspace(0.0, 10.0, 40):
        controller.joints[0] = float((slew + np.pi) % (2 * np.pi) - np.pi)
        controller.send()
        seen.append(driver.read().joint_position_rad_m[0, 0])
    driver.close()
    assert seen == pytest.approx(list(np.linspace(0.0, 10.0, 40)), abs=1e-5)


def test_controller_that_is_not_there_fails_with_the_reason(module_name, controller):
    with pytest.raises(UsageError, match="cannot be made"):
        load_driver(module_name, {"address": "127.0.0.1:9", "listen": "nonsense"}, 0)


@each(
    ("name", "options", "message"),
    [
        ("no_such_package:Driver", {}, "cannot be imported"),
        ("fake_driver:NoSuchClass", {}, "cannot be imported"),
        ("fake_driver:FakeDriver", {"unknown": "1"}, "must take the keywords unknown"),
        ("pathlib:PurePath", {}, r"has no count, now_ns\(\)"),
        ("fake_driver:FakeDriver", {"count": "2"}, "serves 2 machines"),
    ],
)
def test_drivers_that_cannot_be_used_are_explained(name, options, message):
    with pytest.raises(UsageError, match=message):
        load_driver(name, options, 0)


def test_simulated_drivers_get_their_unit():
    assert load_driver("fake_driver:FakeDriver", {"holds_load": "yes"}, 7).unit_seed == 7
