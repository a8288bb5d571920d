"""Rows as JSON and back: nothing lost, nothing invented."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.channels import LOG_CHANNELS
from machine.conventions import UNIT_SUFFIXES
from runtime.records.throw_log import (
    ROW_TYPES,
    channel_schema,
    metadata_from_text,
    metadata_to_text,
    row_to_json,
    rows_from_json,
)
from tests.cases import each
from tests.runtime.log_samples import random_rows


@settings(deadline=None, max_examples=25)
@given(st.sampled_from(sorted(ROW_TYPES)), st.integers(0, 2**32 - 1))
def test_rows_round_trip_to_the_last_bit(name, seed):
    rows = random_rows(name, 3, seed, specials=True)
    back = rows_from_json(name, [row_to_json(row) for row in rows])
    for field in rows.dtype.names:
        # Infinities have no JSON; they come back as not-a-number, like everything unmeasured.
        expected = rows[field]
        if expected.dtype.kind == "f":
            expected = np.where(np.isfinite(expected), expected, np.nan)
        np.testing.assert_array_equal(back[field], expected)


def test_json_is_strict_for_every_reader():
    rows = random_rows("control", 1, 0)
    rows["sensor_position_rad_m"] = [[math.nan, math.inf, -math.inf, 1.5]]
    text = row_to_json(rows[0]).decode()
    decoded = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    assert decoded["sensor_position_rad_m"] == [None, None, None, 1.5]


def test_missing_fields_are_nan_and_unknown_ones_ignored():
    rows = rows_from_json("imu", [b'{"t_mono_ns": 5, "new_field_m": 1.0}'])
    assert rows["t_mono_ns"][0] == 5
    assert np.isnan(rows["gyro_rad_per_s"]).all()


@each("message", [b"[]", b"{", b'{"gyro_rad_per_s": [1, 2]}', b'{"gyro_rad_per_s": "x"}'])
def test_messages_that_do_not_fit_are_errors(message):
    with pytest.raises(ValueError):
        rows_from_json("imu", [message])


def test_schemas_name_every_field_with_its_unit():
    for name in LOG_CHANNELS:
        schema = channel_schema(name)
        assert schema["type"] == "object"
        if name in ROW_TYPES:
            assert list(schema["properties"]) == list(ROW_TYPES[name].names)
            for field, kind in schema["properties"].items():
                inner = kind.get("items", kind)["type"]
                assert inner == "boolean" or field.endswith(UNIT_SUFFIXES)


def test_metadata_keeps_types_and_precision():
    values = {"a": 0.1 + 0.2, "b": {"c": [1, None, "x"]}, "d": "text"}
    assert metadata_from_text(metadata_to_text(values)) == values
    assert metadata_from_text({"plain": "no JSON"}) == {"plain": "no JSON"}
