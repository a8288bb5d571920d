from pathlib import Path

import pytest

from cli.main import main
from machine.calibration import load_calibration, nominal_calibration
from machine.registration import TermKind
from machine.spec import load_spec
from sim_twin.commissioning import machine_measurement, registration_throws
from sim_twin.commissioning.response_fit import ResponseFit
from sim_twin.twin.profile import load_profile, nominal_profile


def test_a_driver_without_surface_heights_is_calibrated_on_the_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = load_spec()
    fit = ResponseFit(0.1, 10.0, 1.0, 1.0, 0.99, 0.01)
    profile = nominal_profile(spec).model_copy(update={"machine_id": "yard-1"})
    tables = nominal_calibration(spec, "yard-1")
    monkeypatch.setattr(machine_measurement, "calibrate", lambda *_: tables)
    monkeypatch.setattr(machine_measurement, "identify_profile", lambda *_: (profile, (fit,) * 4))
    monkeypatch.setattr(registration_throws, "FLAT_THROW_COUNT", 16)
    monkeypatch.setattr(registration_throws, "GROUND_THROW_COUNT", 8)
    monkeypatch.setattr(registration_throws, "RAISED_THROW_COUNT", 8)
    plant = "tests.sim_twin.minimal_plant:MinimalPlant"
    arguments = ["calibrate", "--plant", plant, "--machine-id", "yard-1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    assert "no set_surface_height" in capsys.readouterr().out
    found = load_calibration(tmp_path / "yard-1.calibration.json")
    heights = {TermKind.HEIGHT, TermKind.HEIGHT_SQUARED}
    for registrations in (found.registrations, found.twin_registrations):
        assert len(registrations) == 2
        assert all(not heights & {term.kind for term in r.terms} for r in registrations)
    assert load_profile(tmp_path / "yard-1.profile.json").machine_id == "yard-1"
