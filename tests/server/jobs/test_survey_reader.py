"""Survey files that people send, honest and hostile, through the process with limits."""

import pytest

from machine.errors import UsageError
from server.jobs.job_ground import SurveyReader
from tests.bulk.hostile_surveys import deflated_raster

CELL_M = 0.2
MIB = 1024 * 1024


@pytest.fixture
def reader():
    reader = SurveyReader()
    yield reader
    reader.close()


def test_a_raster_that_becomes_too_large_ends_in_its_process_and_the_next_is_read(reader):
    hostile = deflated_raster(4096 * MIB)
    assert len(hostile) < 5 * MIB
    with pytest.raises(UsageError, match="the survey"):
        reader.read(hostile, CELL_M)
    grid, heights = reader.read(deflated_raster(MIB), CELL_M)
    assert heights.shape == (grid.row_count, grid.column_count) == (30, 30)


def test_a_file_that_takes_too_long_is_refused_with_the_limit(reader):
    reader._process._read_s = 0.0
    with pytest.raises(UsageError, match="the survey took more than 0 s or 2 GiB to read"):
        reader.read(deflated_raster(MIB), CELL_M)
