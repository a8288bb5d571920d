import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.viewer.replay import Playback, ThrowMotion, moment
from tests.cases import each


def motion(release_s: float | None = 0.5, flight_s: float = 1.0) -> ThrowMotion:
    frames = np.linspace(0.0, 1.0, 51)[:, None] * np.arange(1.0, 7.0)
    path = np.linspace([2.0, 0.0, 3.0], [9.0, 0.0, 0.0], 11)
    return ThrowMotion(frames, 0.02, path, release_s, flight_s)


def test_the_duration_reaches_the_later_of_machine_and_load() -> None:
    assert motion().duration_s == pytest.approx(1.5)
    assert motion(flight_s=0.1).duration_s == pytest.approx(1.0)
    assert motion(release_s=None).duration_s == pytest.approx(1.0)


@given(at_s=st.floats(-5.0, 5.0))
def test_a_moment_lies_between_its_frames_and_is_clamped(at_s: float) -> None:
    joints = moment(motion(), at_s).joints_rad_m
    np.testing.assert_allclose(joints, np.clip(at_s, 0.0, 1.0) * np.arange(1.0, 7.0), atol=1e-9)


@given(at_s=st.floats(-1.0, 4.0))
def test_the_load_is_held_then_flies_then_lies_at_its_impact(at_s: float) -> None:
    ball = moment(motion(), at_s).ball_m
    if at_s < 0.5:
        assert ball is None
    else:
        flown = min(at_s - 0.5, 1.0)
        assert ball == pytest.approx((2.0 + 7.0 * flown, 0.0, 3.0 - 3.0 * flown), abs=1e-9)


def test_a_load_that_never_leaves_is_held_to_the_end() -> None:
    assert moment(motion(release_s=None), 9.0).ball_m is None


def test_one_frame_and_no_path_are_drawn_too() -> None:
    still = ThrowMotion(np.ones((1, 6)), 0.02, np.zeros((0, 3)), 0.0, 1.0)
    drawn = moment(still, 0.7)
    assert drawn.joints_rad_m.tolist() == [1.0] * 6
    assert drawn.ball_m is None


@each("shape", [(5,), (5, 5), (2, 6, 1)])
def test_frames_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"\(T, 6\)"):
        ThrowMotion(np.zeros(shape), 0.02, np.zeros((0, 3)))


def test_playing_follows_the_clock_and_stops_at_the_end() -> None:
    playback = Playback(motion())
    playback.advance(100.0)
    assert playback.at_s == 0.0
    playback.advance(100.25)
    assert playback.at_s == pytest.approx(0.25)
    assert playback.ended_for_s(100.25) < 0.0
    playback.advance(200.0)
    assert (playback.at_s, playback.is_playing) == (pytest.approx(1.5), False)
    assert playback.ended_for_s(201.0) == pytest.approx(1.0)


def test_pause_seek_speed_and_play_again() -> None:
    playback = Playback(motion())
    playback.advance(0.0)
    playback.play(False)
    playback.advance(9.0)
    assert playback.at_s == 0.0
    playback.seek(1.2)
    assert playback.advance(10.0).ball_m is not None
    playback.play(True, 0.5)
    playback.advance(10.2)
    assert playback.at_s == pytest.approx(1.3)
    playback.seek(99.0)
    assert playback.at_s == pytest.approx(1.5)
    playback.play(True)
    assert playback.at_s == 0.0


@given(speed=st.floats(-10.0, 100.0))
def test_speed_stays_within_what_can_be_watched(speed: float) -> None:
    playback = Playback(motion())
    playback.play(True, speed)
    assert 0.05 <= playback.speed_ratio <= 8.0
