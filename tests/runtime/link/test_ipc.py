"""Packets between the two processes: whole, in order, bounded, and the end of the peer is noticed."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.telemetry import CONTROL_ROW, IMU_ROW
from runtime.link.ipc import (
    PACKET_LIMIT_BYTES,
    Kind,
    PacketSocket,
    PeerGoneError,
    pack_rows,
    packet_pair,
    unpack_rows,
)
from tests.cases import each

DTYPES = {1: CONTROL_ROW, 3: IMU_ROW}


@pytest.fixture
def pair() -> Iterator[tuple[PacketSocket, PacketSocket]]:
    one, two = (PacketSocket(end) for end in packet_pair())
    yield one, two
    one.close()
    two.close()


def test_packets_arrive_whole_and_in_order(pair):
    one, two = pair
    assert one.send_json(Kind.COMMAND, {"n": 1})
    assert one.send(Kind.TICK, b"")
    first, second = two.receive(), two.receive()
    assert (first.kind, first.json) == (Kind.COMMAND, {"n": 1})
    assert (second.kind, second.body) == (Kind.TICK, b"")
    assert two.receive() is None


def test_a_full_socket_drops_and_counts_and_later_recovers(pair):
    one, two = pair
    sent = 0
    while one.send(Kind.TICK, sent.to_bytes(4, "little") + bytes(500)):
        sent += 1
        assert sent < 100_000, "the socket is not bounded"
    assert one.dropped_count == 1
    assert sent > 50
    received = []
    while (packet := two.receive()) is not None:
        received.append(int.from_bytes(packet.body[:4], "little"))
    assert received == list(range(sent))
    assert one.send(Kind.TICK, b"again")


def test_peer_end_is_noticed_after_its_last_packet(pair):
    one, two = pair
    two.send(Kind.TICK, b"unread by one")
    one.send(Kind.EVENT, b"last words")
    one.close()
    assert two.receive().body == b"last words"
    with pytest.raises(PeerGoneError):
        two.receive()
    with pytest.raises(PeerGoneError):
        two.send(Kind.TICK, b"")


def test_killed_peer_leaves_its_packets():
    mine, theirs = packet_pair()
    code = (
        "import socket, sys, time\n"
        "from runtime.link.ipc import *\n"
        f"s = PacketSocket(socket.socket(fileno={theirs.fileno()}))\n"
        "for n in range(20): s.send(Kind.EVENT, bytes([n]))\n"
        "print('sent', flush=True); time.sleep(60)\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], pass_fds=[theirs.fileno()], stdout=subprocess.PIPE
    )
    theirs.close()
    end = PacketSocket(mine)
    end.send(Kind.COMMAND, b"never read")
    assert child.stdout.readline() == b"sent\n"
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert [end.receive().body[0] for _ in range(20)] == list(range(20))
    with pytest.raises(PeerGoneError):
        end.receive()
    end.close()


def test_oversized_packets_are_a_programming_error(pair):
    with pytest.raises(ValueError, match="exceeds"):
        pair[0].send(Kind.TICK, bytes(PACKET_LIMIT_BYTES))


@given(st.integers(0, 5), st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_rows_round_trip(control_count, imu_count, seed):
    rng = np.random.default_rng(seed)
    parts = {
        tag: np.frombuffer(rng.bytes(count * dtype.itemsize), dtype)
        for (tag, dtype), count in zip(DTYPES.items(), (control_count, imu_count), strict=True)
    }
    got = unpack_rows(pack_rows(parts), DTYPES)
    assert {tag: rows.tobytes() for tag, rows in got.items()} == {
        tag: rows.tobytes() for tag, rows in parts.items()
    }


@given(st.binary(max_size=400))
def test_foreign_bytes_are_refused_or_fit(body):
    try:
        parts = unpack_rows(body, DTYPES)
    except ValueError:
        return
    assert pack_rows(parts) == body or len(parts) < 3


@each("cut", [1, 2, 50])
def test_cut_packets_are_refused(cut):
    body = pack_rows({1: np.zeros(1, CONTROL_ROW)})
    with pytest.raises(ValueError, match="ends within"):
        unpack_rows(body[:cut], DTYPES)
