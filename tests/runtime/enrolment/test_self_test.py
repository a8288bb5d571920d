"""The self-test of a machine that does not run."""

import pytest

from runtime.enrolment import self_test as module
from runtime.enrolment.self_test import self_test
from runtime.process.machine_settings import MachineSettings
from tests.cases import each
from tests.ports import free_port
from tests.runtime.fake_driver import FakeDriver


class SilentImu(FakeDriver):
    def __init__(self):
        super().__init__()
        self.imu_is_silent = True


class Broken(FakeDriver):
    def read(self):
        raise RuntimeError("the bus is down")


class Tilted(FakeDriver):
    def read(self):
        sample = super().read()
        sample.imu_accel_m_per_s2[:, 2] = 4.0
        return sample


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(module, "LINK_WAIT_S", 0.0)
    monkeypatch.setattr(module, "READ_S", 0.2)


def settings(folder, policies, driver):
    return MachineSettings(
        driver=f"{driver.__module__}:{driver.__name__}",
        machine_id="m001",
        site="yard",
        connect=(f"tcp/127.0.0.1:{free_port()}",),
        data_dir=folder,
        policies_dir=policies,
    )


def outcome(tmp_path, policies, driver, offset_s=0.0):
    said = []
    items = self_test(settings(tmp_path, policies, driver), offset_s, said.append)
    assert said == items
    assert [item.name for item in items] == [
        *("link", "clock", "policies", "driver", "imu", "calibration")
    ]
    return {item.name: item for item in items}


@each(
    ("driver", "failed"),
    [
        (FakeDriver, set()),
        (SilentImu, {"imu"}),
        (Tilted, {"imu"}),
        (Broken, {"driver", "imu"}),
    ],
)
def test_it_names_what_the_driver_does_not_give(tmp_path, swing_policies, driver, failed):
    items = outcome(tmp_path, swing_policies, driver)
    found = {name for name in ("driver", "imu") if not items[name].is_passed}
    assert found == failed


@each(("offset_s", "is_passed"), [(0.2, True), (-4.9, True), (5.1, False), (None, False)])
def test_the_clock_is_held_against_the_servers(tmp_path, swing_policies, offset_s, is_passed):
    items = outcome(tmp_path, swing_policies, FakeDriver, offset_s)
    assert items["clock"].is_passed == is_passed


def test_without_server_site_and_calibration_nothing_is_claimed(tmp_path, swing_policies):
    items = outcome(tmp_path, swing_policies, FakeDriver)
    for name, word in (("link", "unreachable"), ("policies", "keys"), ("calibration", "nominal")):
        assert not items[name].is_passed
        assert word in items[name].detail
