"""A latch survives, and whatever cannot be read counts as one."""

import pytest

from machine.messages import ThrowState
from runtime.records.latch_file import RECORD_BYTES, UNKNOWN_ID, LatchFile
from runtime.records.outbox import OutboxError
from runtime.throw.protocol import Latch

STOP = Latch("b.1", ThrowState.STOPPED, "STOP by anna")


def reopened(path):
    return LatchFile(path, is_new_machine=False).latch


def test_a_latch_outlives_the_process(tmp_path):
    path = tmp_path / "latch"
    latches = LatchFile(path, is_new_machine=True)
    assert latches.latch is None and reopened(path) is None
    latches.write(STOP)
    assert latches.latch == STOP == reopened(path)
    fault = Latch("b.2", ThrowState.FAULT, "x" * 1000)
    latches.write(fault)
    assert reopened(path).state is ThrowState.FAULT
    assert path.stat().st_size == RECORD_BYTES
    latches.clear("b.1")
    assert reopened(path).latch_id == "b.2"
    latches.clear("b.2")
    assert latches.latch is None and reopened(path) is None


def test_every_damage_means_stopped(tmp_path):
    path = tmp_path / "latch"
    LatchFile(path, is_new_machine=True)
    good = path.read_bytes()
    damaged = [b"", good[:5], b"\0" * RECORD_BYTES, b"zz" + good[2:], good[:8] + b'{"a":1}']
    damaged += [good[:n] + bytes([good[n] ^ 1]) + good[n + 1 :] for n in range(10)]
    for content in damaged:
        path.write_bytes(content)
        found = reopened(path)
        assert found is not None, content[:20]
        assert (found.latch_id, found.state) == (UNKNOWN_ID, ThrowState.STOPPED)
        assert "unknown" in found.reason
    path.unlink()
    assert reopened(path).latch_id == UNKNOWN_ID


def test_an_unknown_latch_can_be_cleared_by_its_name(tmp_path):
    path = tmp_path / "latch"
    latches = LatchFile(path, is_new_machine=False)
    latches.clear(UNKNOWN_ID)
    assert reopened(path) is None


def test_a_new_machine_does_not_forget_what_is_there(tmp_path):
    path = tmp_path / "latch"
    LatchFile(path, is_new_machine=True).write(STOP)
    assert LatchFile(path, is_new_machine=True).latch == STOP


def test_a_disk_that_refuses_is_an_error_and_the_latch_stays(tmp_path):
    latches = LatchFile(tmp_path / "latch", is_new_machine=True)
    latches.write(STOP)
    (tmp_path / "latch").unlink()
    (tmp_path / "latch").mkdir()
    with pytest.raises(OutboxError, match="check the disk"):
        latches.write(None)
    assert latches.latch == STOP
