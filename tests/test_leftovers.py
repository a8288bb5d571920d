"""What a killed test run leaves behind."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import is_alive, wait_for

RUN = """
import subprocess, sys, time
from tests.leftovers import end_with_run
script = "import subprocess, sys; print(subprocess.Popen(['sleep', '60']).pid, flush=True); sys.stdin.read()"
def start():
    one = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
    )
    end_with_run(one)
    return one, int(one.stdout.readline())
first, grandchild = start()
print(first.pid, grandchild, flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_run_leaves_no_process(number: signal.Signals) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", RUN],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[1],
    ) as run:
        assert run.stdout is not None
        pids = [int(pid) for pid in run.stdout.readline().split()]
        assert len(pids) == 2 and all(is_alive(pid) for pid in pids)
        run.send_signal(number)
    wait_for(lambda: not any(is_alive(pid) for pid in pids))
