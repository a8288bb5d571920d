"""Where the calibration of a plant comes from."""

from pathlib import Path

import pytest

from machine.calibration import ValveCalibration, nominal_calibration
from machine.spec import load_spec
from sim_twin.commissioning import plant_data
from sim_twin.commissioning.plant_data import plant_calibration
from sim_twin.twin.twin import Twin

SPEC = load_spec()


def test_a_calibration_comes_from_the_file_or_is_nominal_for_the_twin(tmp_path: Path) -> None:
    path = tmp_path / "valves.json"
    own = nominal_calibration(SPEC, "m007")
    path.write_text(own.model_dump_json())
    make = Twin.for_plant
    assert plant_calibration("twin", make, unit_seed=0, spec=SPEC, path=path) == own
    nominal = plant_calibration("twin", make, unit_seed=0, spec=SPEC, path=None)
    assert nominal == nominal_calibration(SPEC)


def test_a_measured_calibration_is_kept_until_code_or_unit_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[str] = []

    def measure(plant: object, spec: object, machine_id: str) -> ValveCalibration:
        measured.append(machine_id)
        return nominal_calibration(SPEC, machine_id)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(plant_data, "calibrate", measure)

    def ask(unit_seed: int) -> ValveCalibration:
        return plant_calibration(
            "virtual",
            lambda count: Twin.for_plant(count=1, unit_seed=0),
            unit_seed=unit_seed,
            spec=SPEC,
            path=None,
        )

    assert ask(1) == ask(1)
    assert measured == ["virtual-1"]
    ask(2)
    assert measured == ["virtual-1", "virtual-2"]
    for kept in (tmp_path / "downrange" / "calibration").iterdir():
        kept.write_text("{ half")
    ask(1)
    assert measured[-1] == "virtual-1", "a broken file is measured again"


def test_a_cache_that_cannot_be_written_costs_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setattr(plant_data, "calibrate", lambda *_: nominal_calibration(SPEC, "virtual-1"))
    found = plant_calibration(
        "virtual",
        lambda count: Twin.for_plant(count=1, unit_seed=0),
        unit_seed=1,
        spec=SPEC,
        path=None,
    )
    assert found.machine_id == "virtual-1"
