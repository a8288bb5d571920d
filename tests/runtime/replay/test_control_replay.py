"""Recorded sensor samples through the real control step: the outputs are the accepted ones."""

import numpy as np
import pytest

from machine.conventions import Motion
from tests.cases import each
from tests.runtime.replay import recording
from tests.runtime.replay.difference import differences, waveform


@each("name", recording.names())
def test_the_control_step_gives_the_accepted_outputs(name):
    known = recording.load(name)
    changes = differences(known.outputs, recording.replay(known))
    if changes:
        pytest.fail(
            f"{name}: the outputs of the control step changed in {len(changes)} columns:\n"
            + "\n".join(changes)
            + "\nWhere this is meant: python -m tests.runtime.replay.record accept",
            pytrace=False,
        )


def test_the_recordings_hold_whole_throws():
    for name in ("throw_2d", "throw_3d"):
        known = recording.load(name)
        for motion in (Motion.HOLD, Motion.ALIGN, Motion.THROW, Motion.SETTLE):
            assert (known.motion == motion).any(), (name, motion)
        assert known.outputs["load_gone"].any(), name


def test_a_change_is_shown_with_channel_time_values_and_waveform():
    old = {"valve": np.zeros((200, 2)), "code": np.zeros(200, dtype=np.int32)}
    new = {name: values.copy() for name, values in old.items()}
    new["valve"][120:, 1] = 0.5
    new["valve"][3, 0] = 1e-6
    (text,) = differences(old, new)
    first, *lines = text.splitlines()
    assert (
        first == "valve[1]: 80 of 200 ticks changed, first at 1.20 s: 0 -> 0.5, largest change 0.5"
    )
    assert lines[0].split() == ["old", "▁" * 60]
    assert lines[1].split() == ["new", "▁" * 15 + "█" * 45]
    assert "1.05 s" in lines[2]
    new["valve"][5, 0] = np.nan
    assert "0 -> nan" in "\n".join(differences(old, new))
    assert differences({"a": old["code"]}, {"b": old["code"]}) == ["a: missing now", "b: new"]
    assert differences({"a": np.zeros(2)}, {"a": np.zeros(3)}) == ["a: shape (2,) -> (3,)"]
    assert waveform(np.array([0.0, np.nan, 1.0]), 0.0, 1.0) == "▁?█"
