"""A stopped or spinning process is noticed; one that is only starved is left alone for a while."""

import os
import subprocess
import sys
import time

from runtime.process.alive_counter import AliveCounter, process_state
from runtime.process.hang_watch import CONTROL_LIMITS, LINK_LIMITS, HangWatch


def run(
    state="S", use=0.0, silent_after=0.0, until=2.0, step=0.02, rate=100, limits=CONTROL_LIMITS
):
    """Looks every 20 ms at a process that counts until `silent_after`; when and why it was said to hang."""
    watch, now = HangWatch(limits), 100.0
    while now < 100.0 + until:
        elapsed = now - 100.0
        value = int(min(elapsed, silent_after) * rate)
        reason = watch.look(value, state, use * elapsed, now)
        if reason:
            return elapsed - silent_after, reason
        now += step
    return None


def test_a_living_process_does_not_hang():
    assert run(silent_after=10.0) is None
    assert run(state="R", use=1.0, silent_after=10.0) is None


def test_a_stopped_process_is_noticed_within_200_ms():
    for state in "TtZX":
        seconds, reason = run(state=state, silent_after=0.5)
        assert 0.12 < seconds < 0.2 and "stopped" in reason


def test_a_spinning_process_is_noticed_within_200_ms():
    seconds, reason = run(state="R", use=1.0, silent_after=0.5)
    assert 0.15 < seconds < 0.2 and "busy" in reason


def test_a_starved_process_gets_a_second():
    seconds, reason = run(state="R", use=0.1, silent_after=0.5)
    assert 1.0 < seconds < 1.1 and "silent" in reason


def test_a_link_that_counts_ten_times_a_second():
    link = {"limits": LINK_LIMITS, "rate": 10, "until": 12.0}
    assert run(silent_after=20.0, **link) is None
    for after in (0.5, 0.59):  # just counted, and about to count
        seconds, reason = run(state="T", silent_after=after, **link)
        assert 0.0 < seconds < 0.2 and "stopped" in reason
    # Busy, or waiting for a disk: commands go on in other threads.
    for state, use in (("R", 1.0), ("D", 0.0)):
        seconds, reason = run(state=state, use=use, silent_after=0.5, **link)
        assert 9.9 < seconds < 10.1 and "silent" in reason


def test_a_watch_that_was_itself_not_run_knows_nothing():
    assert run(state="T", silent_after=0.5, step=0.11) is None


def test_the_counter_is_shared_with_another_process():
    counter = AliveCounter()
    code = (
        "import sys, time\n"
        "from runtime.process.alive_counter import AliveCounter\n"
        "counter = AliveCounter(int(sys.argv[1]))\n"
        "counter.add(); counter.add()\n"
        "time.sleep(60)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(counter.descriptor)], pass_fds=(counter.descriptor,)
    )
    try:
        end_s = time.monotonic() + 30.0
        while counter.value < 2 and time.monotonic() < end_s:
            time.sleep(0.01)
        assert counter.value == 2
        state, used_s = process_state(process.pid)
        assert state in "SRD" and used_s >= 0.0
    finally:
        process.kill()
        process.wait()
        counter.close()
    assert process_state(process.pid) == ("X", 0.0)
    assert process_state(os.getpid())[0] == "R"
