"""Half of the tasks run in a worker process, and all in the calling one when the worker is gone."""

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from diagnosis.worker_process import WorkerProcess
from tests.diagnosis.worker_functions import fail_on_odd, kill_worker, scale
from tests.source_tree import ROOT
from tests.waiting import is_alive, wait_for


def test_each_process_computes_half_in_order() -> None:
    with closing(WorkerProcess()) as worker:
        worker.preload(scale)
        worker.hold(10)
        found = worker.split(scale, 10, [1, 2, 3, 4, 5], 1)
    assert [result for result, _ in found] == [11, 21, 31, 41, 51]
    ours, theirs = {pid for _, pid in found[::2]}, {pid for _, pid in found[1::2]}
    assert ours == {os.getpid()}
    assert len(theirs) == 1
    assert ours.isdisjoint(theirs)


def test_where_the_worker_is_gone_the_calling_process_does_all() -> None:
    with closing(WorkerProcess()) as worker:
        worker.hold(10)
        assert worker.split(kill_worker, os.getpid(), [1, 2, 3]) == [1, 2, 3]
        worker.preload(scale)
        worker.hold(10)
        found = worker.split(scale, 10, [1, 2, 3], 0)
    assert found == [(10, os.getpid()), (20, os.getpid()), (30, os.getpid())]


def test_an_error_of_either_half_is_raised_and_harms_no_later_work() -> None:
    with closing(WorkerProcess()) as worker:
        worker.hold(1)
        for items in ([2, 3], [3, 2]):
            with pytest.raises(ValueError, match="1: odd items"):
                worker.split(fail_on_odd, 1, items)
            assert worker.split(fail_on_odd, 1, [2, 4]) == [2, 4]


def test_a_value_that_cannot_be_sent_is_an_error() -> None:
    with closing(WorkerProcess()) as worker:
        worker.hold(lambda: 1)
        with pytest.raises(Exception, match=r"pickle|local object"):
            worker.split(scale, 1, [1, 2], 0)


def test_the_worker_ends_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "diagnosis_of_somebody.py"
    script.write_text(
        "import signal\n"
        "from diagnosis.worker_process import WorkerProcess\n"
        "from tests.diagnosis.worker_functions import scale\n"
        "if __name__ == '__main__':\n"
        "    worker = WorkerProcess()\n"
        "    worker.hold(0)\n"
        "    (_, ours), (_, theirs) = worker.split(scale, 0, [1, 2], 0)\n"
        "    print(theirs, flush=True)\n"
        "    signal.pause()\n"
    )
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": "."},
        cwd=ROOT,
    ) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert is_alive(worker)
        parent.kill()
    wait_for(lambda: not is_alive(worker))
