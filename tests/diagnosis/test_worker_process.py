"""Half of the tasks run in a worker process, and all in the calling one when the worker is gone."""

import os
from contextlib import closing

import pytest

from diagnosis.worker_process import WorkerProcess
from tests.diagnosis.worker_functions import fail_on_odd, scale


def test_each_process_computes_half_in_order() -> None:
    with closing(WorkerProcess()) as worker:
        worker.preload(scale)
        worker.hold(10)
        found = worker.split(scale, 10, [1, 2, 3, 4, 5], 1)
        assert worker.is_running
    assert not worker.is_running
    assert [result for result, _ in found] == [11, 21, 31, 41, 51]
    ours, theirs = {pid for _, pid in found[::2]}, {pid for _, pid in found[1::2]}
    assert ours == {os.getpid()}
    assert len(theirs) == 1
    assert ours.isdisjoint(theirs)
    # A closed worker: the calling process does all.
    found = worker.split(scale, 10, [1, 2, 3], 0)
    assert found == [(10, os.getpid()), (20, os.getpid()), (30, os.getpid())]


def test_an_error_is_raised_by_the_calling_process() -> None:
    with closing(WorkerProcess()) as worker:
        worker.hold(1)
        with pytest.raises(ValueError, match="1: odd items"):
            worker.split(fail_on_odd, 1, [2, 3])
        assert worker.split(fail_on_odd, 1, [2, 4]) == [2, 4]
        # After an error of the calling process no late answer is taken for the next one.
        with pytest.raises(ValueError, match="1: odd items"):
            worker.split(fail_on_odd, 1, [3, 2])
        assert worker.split(fail_on_odd, 1, [4, 6]) == [4, 6]
