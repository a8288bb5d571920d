"""Half of the work in a second process, and all of it in the first if that is gone."""

import os
from contextlib import closing

import pytest

from diagnosis.second_process import SecondProcess
from tests.diagnosis.second_work import broken, times


def test_both_processes_do_half_and_results_keep_their_order() -> None:
    with closing(SecondProcess()) as second:
        second.keep(10)
        found = second.halved(times, 10, [1, 2, 3, 4, 5], 1)
    assert [result for result, _ in found] == [11, 21, 31, 41, 51]
    mine, theirs = {pid for _, pid in found[::2]}, {pid for _, pid in found[1::2]}
    assert mine == {os.getpid()}
    assert len(theirs) == 1
    assert mine.isdisjoint(theirs)


def test_without_the_second_process_the_first_does_all() -> None:
    with closing(SecondProcess()) as second:
        second.keep(10)
        second.close()
        found = second.halved(times, 10, [1, 2, 3], 0)
    assert found == [(10, os.getpid()), (20, os.getpid()), (30, os.getpid())]


def test_an_error_of_the_work_is_told_by_the_first_process() -> None:
    with closing(SecondProcess()) as second:
        second.keep(1)
        with pytest.raises(ValueError, match="1: odd items"):
            second.halved(broken, 1, [2, 3])
        assert second.halved(broken, 1, [2, 4]) == [2, 4]


def test_after_an_error_of_the_first_no_answer_is_taken_for_another() -> None:
    with closing(SecondProcess()) as second:
        second.keep(1)
        with pytest.raises(ValueError, match="1: odd items"):
            second.halved(broken, 1, [3, 2])
        assert second.halved(broken, 1, [4, 6]) == [4, 6]


def test_it_ends_with_the_first_process() -> None:
    second = SecondProcess()
    second.keep(1)
    assert second.is_there
    second.close()
    assert not second.is_there
