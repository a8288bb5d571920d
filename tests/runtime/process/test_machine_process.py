"""Starting a machine: what cannot start says why, and two never run on one folder."""

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import ValidationError

import cli.machine
from cli.main import main
from machine.errors import UsageError
from runtime.process import machine_process
from runtime.process.machine_process import MachineProcess
from runtime.process.machine_settings import MachineSettings
from tests.cases import each

ROOT = Path(__file__).parents[3]


def settings(folder: Path, **changes) -> MachineSettings:
    fields = {
        "driver": "tests.runtime.fake_driver:FakeDriver",
        "machine_id": "m001",
        "site": "yard",
        "data_dir": folder,
        "policies_dir": folder,
        "is_real_time": False,
    }
    return MachineSettings.model_validate(fields | changes)


def start(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", "cli.main", "machine", "--machine-id", "m001", *arguments],
        env=environment, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


def test_driver_that_cannot_be_made_ends_the_start_with_the_reason(tmp_path):
    ended = start("--data", str(tmp_path / "data"), "--driver", "tests.runtime.fake_driver:Nothing")
    assert ended.returncode == 1
    assert (
        "driver tests.runtime.fake_driver:Nothing cannot be imported"
        in ended.stderr.splitlines()[-1]
    )


def test_database_of_another_machine_ends_the_start_with_the_reason(tmp_path):
    from runtime.records.outbox import Outbox

    Outbox(tmp_path / "machine.db", "m009").close()
    ended = start(
        "--data",
        str(tmp_path),
        "--driver",
        "tests.runtime.fake_driver:FakeDriver",
        "--no-real-time",
    )
    assert ended.returncode == 1
    assert "belongs to machine m009" in ended.stderr.splitlines()[-1]


def test_folder_in_use_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(machine_process, "LOCK_LIMIT_S", 0.1)
    held = os.open(tmp_path / "machine.lock", os.O_RDWR | os.O_CREAT)
    fcntl.flock(held, fcntl.LOCK_EX)
    with pytest.raises(UsageError, match="another process of machine m001"):
        MachineProcess(settings(tmp_path))
    os.close(held)


@each(
    ("changes", "message"),
    [
        ({"machine_id": "M 1"}, "is no name"),
        ({"site": "a/b"}, "is no name"),
        ({"driver": "driver.py"}, "pattern"),
        ({"unit_seed_count": -1}, "greater than or equal"),
        ({"typo": 1}, "Extra inputs"),
    ],
)
def test_settings_that_cannot_work_are_refused(tmp_path, changes, message):
    with pytest.raises(ValidationError, match=message):
        settings(tmp_path, **changes)


def test_settings_survive_the_way_to_the_processes(tmp_path):
    given = settings(tmp_path, connect=("tcp/a:1",), driver_options={"a": "b"})
    assert MachineSettings.model_validate_json(given.model_dump_json()) == given


def test_command_line_errors_are_in_words(tmp_path):
    with pytest.raises(UsageError, match="'nonsense' is not name=value"):
        cli.machine.run(machine_id="m001", data=tmp_path, driver_option=("nonsense",))
    with pytest.raises(UsageError, match="machine_id"):
        cli.machine.run(machine_id="no name", data=tmp_path)


def test_help_names_every_option(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["machine", "--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    for option in ("--driver", "--connect", "--password-file", "--policies", "--unit-seed"):
        assert option in shown
