"""Checks of versions in a process of their own: what is wrong, and what exceeds its limits."""

import os
import threading

import pytest

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import read_policy
from server.deployments.policy_checks import check_in_child
from tests.cases import each
from tests.runtime.quick_policy import write_policy

LONG_S = 300.0


@pytest.fixture
def files(tmp_path):
    write_policy(tmp_path / "checked-2d", Mode.PLANAR, 0.2)
    return read_policy(tmp_path / "checked-2d")


def hang(files):
    threading.Event().wait()


def die(files):
    os._exit(9)


def grow(files):
    bytearray(1 << 40)


def test_the_process_takes_what_a_machine_takes(files):
    check_in_child(files, time_limit_s=LONG_S)


@each(
    ("check", "limit_s", "words"),
    [
        (hang, 1.0, r"checked-2d takes more than 1 s to load"),
        (die, LONG_S, r"exit code 9"),
        (grow, LONG_S, r"needs more than 4 GiB"),
    ],
)
def test_what_hangs_dies_or_grows_is_refused(files, check, limit_s, words):
    with pytest.raises(PolicyError, match=words):
        check_in_child(files, check, time_limit_s=limit_s)
