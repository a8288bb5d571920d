"""Valve tables: refused when they cannot be inverted, read back as written."""

import numpy as np
import pytest
from pydantic import ValidationError

from machine.calibration import (
    ValveTable,
    actuator_ratio,
    load_calibration,
    nominal_calibration,
)
from machine.errors import UsageError
from machine.spec import load_spec
from tests.cases import each

SPEC = load_spec()


@each(
    ("valve", "speed"),
    [
        ((-1.0, 0.0, 1.0), (-0.1, 0.0)),
        ((-1.0, 1.0), (-0.1, 0.1)),
        ((-1.0, 0.5, 0.5), (-0.1, 0.0, 0.1)),
        ((-1.0, 0.0, 1.0), (-0.1, 0.1, 0.1)),
    ],
)
def test_a_table_that_cannot_be_inverted_is_refused(valve, speed):
    with pytest.raises(ValidationError):
        ValveTable(valve_ratio=valve, actuator_speed_rad_m_per_s=speed)


def test_files_come_back_as_written(tmp_path):
    path = tmp_path / "calibration.json"
    path.write_text(nominal_calibration(SPEC).model_dump_json())
    assert load_calibration(path) == nominal_calibration(SPEC)


@each("text", ["", "{}", "[1]", '{"machine_id": "m"}'])
def test_a_broken_file_names_itself_and_the_remedy(tmp_path, text):
    path = tmp_path / "broken.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"(?s)broken\.json.*downrange calibrate"):
        load_calibration(path)


def test_dipper_cylinder_shortens_as_the_joint_opens():
    ratio = actuator_ratio(SPEC, np.array([[0.0, 0.5, 0.0, 0.5]]))[0]
    assert ratio[0] == ratio[3] == 1.0
    assert ratio[1] > 0.3
    assert ratio[2] < -0.3
