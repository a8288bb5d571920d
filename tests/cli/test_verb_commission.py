import json
from pathlib import Path

import numpy as np
import pytest

from cli.commissioning import steps
from cli.main import main
from diagnosis.identification.quantity import AxisSwing, Quantity, unknown
from diagnosis.identification.release_delay import ReleaseDelay
from diagnosis.loading.throw_data import LoadedSet
from machine.calibration import load_calibration, nominal_calibration
from machine.registration import Registration
from machine.spec import load_spec
from runtime.records.log_reader import read_throw_log
from sim_twin.commissioning.drive_identification import JointExplanation
from sim_twin.commissioning.machine_measurement import MachineMeasurement
from sim_twin.commissioning.response_fit import ResponseFit
from sim_twin.twin.oil_spring import OilSpringDrive
from sim_twin.twin.profile import load_profile, nominal_profile
from tests.cases import each

SPEC = load_spec()
PLANT = "tests.sim_twin.minimal_plant:MinimalPlant"
TABLES = nominal_calibration(SPEC, "yard-1")
DRIVE = OilSpringDrive(
    dead_time_s=0.1,
    valve_lag_s=0.05,
    natural_frequency_rad_per_s=7.0,
    oil_damping_ratio=0.2,
    friction_damping_ratio=0.1,
)
JOINTS = tuple(
    JointExplanation(
        joint=joint,
        drive=DRIVE,
        is_oil_spring=True,
        linear_explained_ratio=0.9,
        explained_ratio=explained,
        unexplained_by_phase_ratio={"rise": 0.2, "reversal": 0.1, "ringing": 0.7},
        residual_rad_m_per_s=0.02,
        at_bound=at_bound,
        plot_s=np.linspace(0.0, 1.0, 20),
        plot_measured=np.linspace(0.0, 0.5, 20),
        plot_simulated=np.linspace(0.0, 0.4, 20),
    )
    for joint, explained, at_bound in (
        ("slew", 0.95, ("gain_ratio",)),
        ("boom", 0.99, ()),
        ("dipper", 0.99, ()),
        ("telescope", 0.99, ()),
    )
)


def known(value: float, unit: str) -> Quantity:
    return Quantity(unit=unit, value=value, ci90=(0.9 * value, 1.1 * value), count=39)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Measurements with known answers, which take no time; the list says which were made."""
    made: list[str] = []

    def answer(name, value):
        def stub(*_, **__):
            made.append(name)
            return value

        return stub

    profile = nominal_profile(SPEC).model_copy(
        update={"machine_id": "yard-1", "version_count": 1, "drives": (DRIVE,) * 4}
    )
    fit = ResponseFit(0.1, 10.0, 1.0, 1.0, 0.99, 0.01)
    registration = Registration(
        policy_sha256="0" * 64,
        throw_count=150,
        range_m=(6.0, 10.0),
        downrange_m=(0.1, -0.2),
        crossrange_m=(0.0, 0.05),
    )
    registered = TABLES.model_copy(update={"registrations": (registration,) * 2})
    friction = {
        "viscous_friction_per_s": known(0.04, "1/s"),
        "coulomb_friction_rad_per_s2": known(0.1, "rad/s2"),
    }
    swing = (
        AxisSwing(joint="pitch", length_m=known(0.95, "m"), **friction),
        AxisSwing(joint="roll", length_m=unknown("m", "no swing in roll"), **friction),
    )
    release = ReleaseDelay(
        mean=known(0.26, "s"),
        sd=known(0.01, "s"),
        latch=known(0.02, "s"),
        method="tracker",
        delays_s=(0.26,),
        single_sd_s=0.004,
        without_switch_count=0,
    )
    for name, value in {
        "calibrate": TABLES,
        "identify_machine": MachineMeasurement(TABLES, profile, (fit,) * 4, JOINTS),
        "identify_release": release,
        "identify_swing": swing,
        "register_policies": registered,
    }.items():
        monkeypatch.setattr(steps, name, answer(name, value))
    tests = LoadedSet(throws=[], refused=[], rates={}, clocks=[])
    monkeypatch.setattr(steps.CommissioningJob, "_test", lambda *_: tests)
    return made


@pytest.fixture
def quick_throws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference throws that are files only."""

    def record(_: object, __: object, throws: int, seed: int, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(throws):
            (folder / f"yard-1-s{seed}-{number:04d}.mcap").touch()

    monkeypatch.setattr(steps.CommissioningJob, "_record", record)


def commission(policies: Path, out: Path, *more: str) -> int:
    arguments = ["commission", "--plant", PLANT, "--machine-id", "yard-1", "--out", str(out)]
    return main([*arguments, "--policies", str(policies), "--reference-throws", "2", *more])


def test_one_command_measures_keeps_and_reports(
    measured: list[str], swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert commission(swing_policies, tmp_path, "--day", "2026-05-01") == 0
    said = capsys.readouterr().out
    assert (
        "slew: the twin explains 95.0 % of its speed; 70 % of what is left lies in what follows"
        in said
    )
    assert "gain_ratio is at a bound" in said
    assert "no swing in roll" in said
    assert "2 reference throws are too few" in said
    profile = load_profile(tmp_path / "yard-1.profile.json")
    assert profile.drives == (DRIVE,) * 4
    assert profile.release_delay_s == 0.26
    assert profile.viscous_friction_per_s == (0.04, 0.04)
    assert len(load_calibration(tmp_path / "yard-1.calibration.json").registrations) == 2
    logs = sorted((tmp_path / "yard-1.reference" / "2026-05-01").glob("*.mcap"))
    kept = [read_throw_log(path).metadata for path in logs]
    assert [log["mode"] for log in kept] == ["2d", "3d"]
    assert {log["machine_id"] for log in kept} == {"yard-1"}
    assert all(log["twin_profile"]["drives"] for log in kept)
    record = json.loads((tmp_path / "yard-1.commissioning.json").read_text())
    assert record["schema_version"] == 1
    assert record["reference_day_count"] == {"2026-05-01": 2}
    page = (tmp_path / "yard-1.commissioning.html").read_text()
    for part in ("Commissioning of yard-1", "oil spring", "95.0 %", "2026-05-01", "<svg", "0.20 m"):
        assert part in page


@pytest.mark.usefixtures("quick_throws")
def test_it_goes_on_where_it_was_stopped(
    measured: list[str],
    swing_policies: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with monkeypatch.context() as patched:

        def stop(*_: object) -> None:
            raise KeyboardInterrupt

        patched.setattr(steps, "identify_swing", stop)
        assert commission(swing_policies, tmp_path) == 130
    assert measured == ["calibrate", "identify_machine", "identify_release"]
    assert "swing of the gripper" in (tmp_path / "yard-1.commissioning.html").read_text()
    capsys.readouterr()
    assert commission(swing_policies, tmp_path) == 0
    assert measured[3:] == ["identify_swing", "register_policies"]
    assert "step 1 of 6, valve tables: done" in capsys.readouterr().out


@pytest.mark.usefixtures("quick_throws")
def test_another_day_adds_reference_throws_and_measures_nothing_anew(
    measured: list[str], swing_policies: Path, tmp_path: Path
) -> None:
    assert commission(swing_policies, tmp_path, "--day", "2026-05-01") == 0
    count = len(measured)
    assert commission(swing_policies, tmp_path, "--day", "2026-05-01") == 0
    assert commission(swing_policies, tmp_path, "--day", "2026-05-02") == 0
    assert len(measured) == count
    folders = {p.name: len(list(p.iterdir())) for p in (tmp_path / "yard-1.reference").iterdir()}
    assert folders == {"2026-05-01": 2, "2026-05-02": 2}
    assert commission(swing_policies, tmp_path, "--day", "2026-05-02", "--again") == 0
    assert len(measured) == 2 * count


@each(
    ("more", "reason"),
    [
        (("--day", "1 May"), "--day 1 May"),
        (("--machine-id", "Yard 1"), "--machine-id"),
        (("--reference-throws", "0"), "--reference-throws 0"),
    ],
)
def test_options_that_cannot_work(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more, reason
) -> None:
    assert commission(swing_policies, tmp_path, *more) == 1
    assert reason in capsys.readouterr().err


def test_a_file_that_is_no_record_is_refused(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "yard-1.commissioning.json").write_text("{}")
    assert commission(swing_policies, tmp_path) == 1
    assert "no record of a commissioning" in capsys.readouterr().err
