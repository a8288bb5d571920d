"""Result files can be read again, and refuse what a table cannot show."""

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks.result_file import (
    RESULTS,
    Row,
    describe,
    percentile,
    plain,
    read_result,
    row,
    write_result,
)


def test_a_result_is_read_as_it_was_written(tmp_path):
    rows = [row(3, {"machines": 2}, {"p50_ms": percentile([1.0, 2.0, 9.0], 50), "max_ms": 9.0})]
    result = describe("speed", "Speed of a step", rows, seed=1, notes="Target: 2 ms.")
    path = write_result(result, tmp_path / "new" / "speed.json")
    assert read_result(path) == result
    assert result.commit and result.date.count("-") == 2 and "cores" in result.host
    assert result.rows[0].labels == {"machines": "2"}
    assert result.rows[0].values["p50_ms"].value == 2.0


def test_unknown_values_are_null_and_other_fields_are_refused():
    assert plain(float("nan")).value is None and plain(None).value is None
    assert percentile([], 50).value is None
    with pytest.raises(ValidationError):
        Row.model_validate({"labels": {}, "n": 1, "values": {}, "remark": "x"})


def test_intervals_of_percentiles_contain_the_true_value_as_often_as_they_say():
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(400):
        found = percentile(rng.uniform(size=200), 50)
        inside += found.low <= 0.5 <= found.high
    assert 0.92 <= inside / 400 <= 0.98


def test_all_result_files_can_be_read():
    wrong = [path.name for path in RESULTS.glob("*.json") if read_result(path).name != path.stem]
    assert wrong == []
