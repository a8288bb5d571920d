"""The self-test of a machine that does not run: link, clock, policies, driver, IMU, calibration.

Nothing moves: the driver is asked to read, its valves are written closed.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np
import zenoh

from machine.calibration import load_calibration
from machine.conventions import ACTIVE_COUNT, GRAVITY_M_PER_S2, Mode
from machine.errors import DownrangeError, PolicyError
from machine.spec import MachineSpec, load_spec
from runtime.driver import Driver, ValveCommand
from runtime.link.zenoh_config import client_config
from runtime.policies.on_board import OnBoardPolicies
from runtime.policies.slots import PolicySlots
from runtime.process.driver_loader import load_driver
from runtime.process.machine_settings import MachineSettings

LINK_WAIT_S: Final = 20.0
"""The server takes a new machine in at the next moment at which nobody throws."""
CLOCK_OFFSET_S: Final = 5.0
"""As the alert about clocks."""
READ_S: Final = 1.0
PERIOD_S: Final = 0.01
IMU_LEAST_RATE_HZ: Final = 15.0
"""As the safety gate asks for while the machine moves."""
GRAVITY_TOLERANCE_M_PER_S2: Final = 0.5
"""A gripper at rest shows gravity; bias and mounting of an industrial IMU stay within 0.2."""


@dataclass(frozen=True, slots=True)
class TestItem:
    """One line."""

    __test__ = False
    name: str
    is_passed: bool
    detail: str


def self_test(
    settings: MachineSettings, clock_offset_s: float | None, say: Callable[[TestItem], None]
) -> list[TestItem]:
    """Test everything; a part that fails stops no other.

    Args:
        settings: of the machine.
        clock_offset_s: this computer's wall clock minus the server's; None where it is not known.
        say: called with each line as soon as it is known.
    """
    spec = load_spec()
    items: list[TestItem] = []

    def add(name: str, test: Callable[[], str]) -> None:
        try:
            item = TestItem(name, True, test())
        except _FailedError as error:
            item = TestItem(name, False, str(error)[:300])
        except (DownrangeError, OSError, ValueError) as error:
            item = TestItem(name, False, f"{error}"[:300])
        items.append(item)
        say(item)

    add("link", lambda: _link(settings))
    add("clock", lambda: _clock(clock_offset_s))
    add("policies", lambda: _policies(settings, spec))
    reading = _Reading()
    add("driver", lambda: _driver(settings, reading))
    add("imu", lambda: _imu(reading))
    add("calibration", lambda: _calibration(settings))
    return items


class _FailedError(Exception):
    pass


def _link(settings: MachineSettings) -> str:
    began_s = time.monotonic()
    while True:
        try:
            config = client_config(
                connect=settings.connect,
                user=settings.username or settings.machine_id,
                password=settings.password(),
                root_ca_file=settings.root_ca_file,
            )
            with zenoh.open(config):
                seconds = time.monotonic() - began_s
            return f"{settings.connect[0]} takes the password, after {seconds:.1f} s"
        except zenoh.ZError as error:
            if time.monotonic() - began_s > LINK_WAIT_S:
                raise _FailedError(
                    f"{', '.join(settings.connect)} is unreachable or refuses the password"
                ) from error
            time.sleep(0.5)


def _clock(offset_s: float | None) -> str:
    if offset_s is None:
        raise _FailedError("the server's time is not known")
    if abs(offset_s) > CLOCK_OFFSET_S:
        raise _FailedError(f"{offset_s:+.1f} s from the server's clock; synchronise it (NTP)")
    return f"within {max(abs(offset_s), 0.1):.1f} s of the server's"


def _policies(settings: MachineSettings, spec: MachineSpec) -> str:
    slots = PolicySlots(settings.policy_slots_dir)
    if slots.trust() is None:
        raise _FailedError("the site's keys are not on board")
    versions = OnBoardPolicies(slots, settings.policies_dir, spec)
    found: list[str] = []
    for mode in Mode:
        try:
            found.append(f"{mode.value} {versions.start(mode).card.policy_id}")
        except PolicyError as error:
            raise _FailedError(f"{mode.value}: {error}") from error
    return f"{', '.join(found)}: approved by site {settings.site}"


class _Reading:
    """What the driver gave within `READ_S`."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.imu_times: set[int] = set()
        self.force_m_per_s2: list[float] = []

    def take(self, driver: Driver) -> None:
        sample = driver.read()
        if not np.isfinite(sample.joint_position_rad_m).all():
            raise _FailedError("a joint position is no number")
        t_ns = int(sample.imu_t_mono_ns[0])
        if t_ns > 0 and t_ns not in self.imu_times:
            self.imu_times.add(t_ns)
            self.force_m_per_s2.append(float(np.linalg.norm(sample.imu_accel_m_per_s2[0])))


def _driver(settings: MachineSettings, reading: _Reading) -> str:
    driver = load_driver(settings.driver, settings.driver_options, settings.unit_seed_count)
    try:
        closed = ValveCommand(
            valve_ratio=np.zeros((1, ACTIVE_COUNT)), gripper_open=np.zeros(1, dtype=bool)
        )
        began_s, began_ns = time.monotonic(), driver.now_ns()
        count, slowest_s = 0, 0.0
        while time.monotonic() - began_s < READ_S:
            driver.advance(began_ns + int((time.monotonic() - began_s) * 1e9))
            tick_s = time.monotonic()
            reading.take(driver)
            driver.write(closed)
            slowest_s = max(slowest_s, time.monotonic() - tick_s)
            count += 1
            time.sleep(PERIOD_S)
        reading.seconds = time.monotonic() - began_s
    except Exception as error:
        if isinstance(error, _FailedError | DownrangeError):
            raise
        # A driver is code of another package: whatever it raises is its failure.
        raise _FailedError(f"{settings.driver} raised {type(error).__name__}: {error}") from error
    finally:
        driver.close()
    return f"{settings.driver}: {count} readings, the slowest took {slowest_s * 1000.0:.1f} ms"


def _imu(reading: _Reading) -> str:
    if not reading.imu_times:
        raise _FailedError("no sample of the gripper's IMU has come")
    rate_hz = len(reading.imu_times) / reading.seconds
    force = float(np.median(reading.force_m_per_s2))
    if rate_hz < IMU_LEAST_RATE_HZ:
        raise _FailedError(f"{rate_hz:.0f} samples/s; at least {IMU_LEAST_RATE_HZ:.0f} are needed")
    if not math.isfinite(force) or abs(force - GRAVITY_M_PER_S2) > GRAVITY_TOLERANCE_M_PER_S2:
        raise _FailedError(f"shows {force:.2f} m/s2 at rest, gravity is {GRAVITY_M_PER_S2:.2f}")
    return f"{rate_hz:.0f} samples/s, gravity {force:.2f} m/s2"


def _calibration(settings: MachineSettings) -> str:
    if settings.calibration_file is None:
        raise _FailedError("none: the machine throws with nominal valves; run downrange commission")
    load_calibration(settings.calibration_file)
    age = datetime.now(UTC) - datetime.fromtimestamp(
        settings.calibration_file.stat().st_mtime, tz=UTC
    )
    return f"{settings.calibration_file.name}, {_age_text(age)}"


def _age_text(age: timedelta) -> str:
    return "from today" if age < timedelta(days=1) else f"{age.days} days old"
