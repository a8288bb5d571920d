"""Identified ranges go into training stretched as the built-in ones are; what cannot be is refused."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Mode
from machine.errors import UsageError
from tests.cases import each
from training.environment.configurations import RESPONSE_WIDENING_RATIO, task_for
from training.environment.dynamics import DriveResponse, ResponseState, respond
from training.environment.task import ResponseConfig, widened
from training.identified_response import (
    DYNAMICS,
    HIGHEST_NATURAL_FREQUENCY_RAD_PER_S,
    LONGEST_DEAD_TIME_S,
    PARAMETERS,
    IdentifiedResponse,
    ResponseFile,
    ResponseSource,
    read_response,
    with_identified,
)

BUILT_IN = task_for(Mode.PLANAR).response
WHOLE: dict[str, Any] = {
    "dead_time_s": [0.05, 0.09],
    "natural_frequency_rad_per_s": [10.0, 18.0],
    "damping_ratio": [0.6, 1.0],
    "gain_positive_ratio": [0.9, 1.0],
    "gain_negative_ratio": [0.95, 1.05],
}
UNKNOWN = "cannot be known from these logs: 2 throws use it, 6 are needed"


def file(known: dict[str, Any], name: str = "m1.json") -> ResponseFile:
    ranges = {j: {n: tuple(v) for n, v in numbers.items()} for j, numbers in known.items()}
    return ResponseFile(ResponseSource(name, "m1", "0"), ranges)


def written(path: Path, training: Any) -> Path:
    # Python writes NaN where JSON has no such thing; so would a careless tool.
    text = json.dumps({"machine_id": "m1", "result": {"joints": [], "training": training}})
    path.write_text(text, encoding="utf-8")
    return path


def drawn(response: ResponseConfig, joint: str, name: str) -> tuple[float, float]:
    field, index = PARAMETERS[name].field, ACTIVE_JOINTS.index(joint)
    values = asdict(response)
    return values[field.format("min")][index], values[field.format("max")][index]


def line(found: IdentifiedResponse, joint: str) -> str:
    return found.lines[ACTIVE_JOINTS.index(joint)]


def test_a_file_of_identify_response_is_read_with_its_origin(tmp_path: Path):
    training = {"boom": WHOLE, "slew": dict.fromkeys(WHOLE, UNKNOWN)}
    path = written(tmp_path / "m1.json", training)
    found = read_response(path)
    assert found.source == ResponseSource(
        "m1.json", "m1", hashlib.sha256(path.read_bytes()).hexdigest()
    )
    assert found.known["boom"]["dead_time_s"] == (0.05, 0.09)
    assert found.known["slew"] == {}


def test_ranges_go_from_the_lowest_to_the_highest_of_all_files_and_are_stretched():
    other = {**WHOLE, "dead_time_s": [0.03, 0.06], "gain_positive_ratio": [0.92, 1.1]}
    response = with_identified(BUILT_IN, [file({"boom": WHOLE}), file({"boom": other})]).response
    assert RESPONSE_WIDENING_RATIO == 1.25
    assert drawn(response, "boom", "dead_time_s") == pytest.approx((0.0225, 0.0975))
    assert drawn(response, "boom", "gain_positive_ratio") == pytest.approx((0.875, 1.125))
    assert drawn(response, "boom", "natural_frequency_rad_per_s") == pytest.approx((9.0, 19.0))


def test_an_identified_joint_has_neither_lag_nor_reaction_and_the_others_keep_theirs():
    found = with_identified(BUILT_IN, [file({"slew": WHOLE, "boom": WHOLE})])
    response = found.response
    assert response.lag_min_s == response.lag_max_s == (0.001, 0.001, 0.001, 0.001)
    assert response.boom_from_dipper_ratio == (0.0, 0.0)
    assert response.dipper_from_boom_ratio == BUILT_IN.dipper_from_boom_ratio
    for joint in ("dipper", "telescope"):
        for name in PARAMETERS:
            assert drawn(response, joint, name) == drawn(BUILT_IN, joint, name)
    assert response.disturbance_sd_rad_m_per_s == BUILT_IN.disturbance_sd_rad_m_per_s
    assert line(found, "boom") == (
        "boom: from the files dead time 0.045..0.095 s, natural frequency 9..19 rad/s, damping 0.55..1.05, "
        "gain positive 0.887..1.01, gain negative 0.938..1.06, no lag (0.001 s), no reaction of its neighbour"
    )
    assert line(found, "dipper") == (
        "dipper: built in dead time, natural frequency, damping, gain positive, gain negative, lag, "
        "reaction of its neighbour"
    )


def test_two_of_the_three_that_belong_together_are_left_and_gains_are_taken():
    known = {name: WHOLE[name] for name in WHOLE if name != "natural_frequency_rad_per_s"}
    found = with_identified(BUILT_IN, [file({"slew": known})])
    for name in DYNAMICS:
        assert drawn(found.response, "slew", name) == drawn(BUILT_IN, "slew", name)
    assert found.response.lag_max_s == BUILT_IN.lag_max_s
    assert drawn(found.response, "slew", "gain_negative_ratio") == pytest.approx((0.9375, 1.0625))
    assert "built in dead time, natural frequency, damping, lag" in line(found, "slew")


def test_three_numbers_of_three_machines_are_no_machine():
    files = [file({"boom": {name: WHOLE[name]}}) for name in DYNAMICS]
    with pytest.raises(UsageError, match="of no joint all of dead time, natural frequency"):
        with_identified(BUILT_IN, files)
    # A range of another file counts beside a file that holds all three.
    longer = file({"boom": {"dead_time_s": [0.06, 0.13]}})
    response = with_identified(BUILT_IN, [file({"boom": WHOLE}), longer]).response
    assert drawn(response, "boom", "dead_time_s") == pytest.approx((0.04, 0.14))


def test_stretching_stops_at_what_the_simulator_holds():
    slow = {**WHOLE, "dead_time_s": [0.05, 0.199], "natural_frequency_rad_per_s": [50.0, 199.0]}
    response = with_identified(BUILT_IN, [file({"boom": slow})]).response
    assert drawn(response, "boom", "dead_time_s")[1] == LONGEST_DEAD_TIME_S == 0.2
    assert drawn(response, "boom", "natural_frequency_rad_per_s")[1] == 200.0


def test_a_stretched_range_that_reaches_zero_is_refused():
    wide = {**WHOLE, "natural_frequency_rad_per_s": [1.0, 30.0]}
    with pytest.raises(UsageError, match=r"boom natural_frequency_rad_per_s: 1 to 30 rad/s.*zero"):
        with_identified(BUILT_IN, [file({"boom": wide})])


@each(
    ("training", "words"),
    [
        (
            {"boom": {"dead_time_s": [0.09, 0.05]}},
            "boom dead_time_s: 0.09 to 0.05 s: the bounds are swapped",
        ),
        ({"boom": {"damping_ratio": [float("nan"), 1.0]}}, "boom damping_ratio: nan to 1 is not"),
        ({"boom": {"damping_ratio": [0.1, float("inf")]}}, "boom damping_ratio: 0.1 to inf is not"),
        ({"boom": {"gain_positive_ratio": [0.0, 1.0]}}, "the lower bound must be positive"),
        ({"boom": {"dead_time_s": [-0.01, 0.1]}}, "boom dead_time_s: -0.01 to 0.1 s: the lower"),
        ({"boom": {"dead_time_s": [0.1, 0.3]}}, "0.1 to 0.3 s goes beyond the 0.2 s"),
        ({"stick": WHOLE}, "no joint is called 'stick', only slew, boom, dipper, telescope"),
        ({"boom": {"lag_s": [0.1, 0.2]}}, "boom has no 'lag_s', only dead_time_s"),
        ({"boom": dict.fromkeys(WHOLE, UNKNOWN)}, "holds no range for training"),
        ({}, "holds no range for training"),
        ({"boom": {"dead_time_s": [0.1]}}, "result.training.boom.dead_time_s"),
        ({"boom": {"dead_time_s": None}}, "result.training.boom.dead_time_s"),
        ({"boom": {"dead_time_s": [0.1, "0.2"]}}, "result.training.boom.dead_time_s"),
        ([], "is not a result of `downrange identify response` (result.training"),
    ],
)
def test_what_cannot_be_is_refused_with_file_number_and_remedy(
    tmp_path: Path, training: Any, words: str
):
    path = written(tmp_path / "m1.json", training)
    with pytest.raises(UsageError) as refused:
        read_response(path)
    shown = str(refused.value)
    assert words in shown
    assert str(path) in shown
    assert any(word in shown for word in ("write", "identify it from throws"))
    assert "\n" not in shown


@each(
    ("content", "words"),
    [
        (b"not json", "is not a result"),
        (b'{"machine_id": "m1", "result": {"mean": 1}}', "result.training: Field required"),
        (b"\xff\xfe", "is not a result"),
        (b"", "is not a result"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, words: str):
    path = tmp_path / "other.json"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=words):
        read_response(path)
    for missing in (tmp_path / "none.json", tmp_path):
        with pytest.raises(UsageError, match="cannot be read"):
            read_response(missing)


LIMITS = {
    "dead_time_s": (0.0, 0.2),
    "natural_frequency_rad_per_s": (5.0, HIGHEST_NATURAL_FREQUENCY_RAD_PER_S),
    "damping_ratio": (0.1, 3.0),
    "gain_positive_ratio": (0.3, 2.0),
    "gain_negative_ratio": (0.3, 2.0),
}


@st.composite
def joints(draw: st.DrawFn) -> dict[str, dict[str, tuple[float, float]]]:
    """What a machine's logs may say: any joints, any of their numbers."""
    known: dict[str, dict[str, tuple[float, float]]] = {}
    for joint in ACTIVE_JOINTS:
        known[joint] = {}
        for name, (least, most) in LIMITS.items():
            if draw(st.booleans()):
                low = draw(st.floats(least, most))
                # Not so wide that it reaches zero once stretched.
                high = draw(st.floats(low, min(most, max(low, 5.0 * low))))
                known[joint][name] = (low, high)
    return known


@given(st.lists(joints(), min_size=1, max_size=3), st.sampled_from(list(Mode)))
def test_every_machine_identified_is_among_those_drawn(
    machines: list[dict[str, dict[str, tuple[float, float]]]], mode: Mode
):
    built_in = task_for(mode).response
    try:
        response = with_identified(built_in, [file(known) for known in machines]).response
    except UsageError as refused:
        assert "of no joint" in str(refused) or "reaches zero" in str(refused)
        return
    for joint in ACTIVE_JOINTS:
        whole = any(DYNAMICS.keys() <= known[joint].keys() for known in machines)
        for name in PARAMETERS:
            low, high = drawn(response, joint, name)
            ranges = [known[joint][name] for known in machines if name in known[joint]]
            if not ranges or (name in DYNAMICS and not whole):
                assert (low, high) == drawn(built_in, joint, name)
                continue
            assert low <= max(min(r[0] for r in ranges), 0.001) + 1e-12
            assert high >= max(r[1] for r in ranges) - 1e-12
            assert 0.0 < low <= high + 1e-12
            assert high <= PARAMETERS[name].limit
    # The built-in ranges are stretched once, by the task, and not again.
    assert response.dead_time_min_s != widened(built_in, RESPONSE_WIDENING_RATIO).dead_time_min_s


@given(st.floats(0.05, 3.0), st.floats(1.0, HIGHEST_NATURAL_FREQUENCY_RAD_PER_S), st.booleans())
def test_what_the_limits_allow_does_not_explode_in_the_simulator(
    damping: float, natural_frequency: float, both: bool
):
    """If `both` are identified, boom and dipper have no reaction; else the dipper keeps its own."""
    four = np.ones((1, 4))
    response = DriveResponse(
        dead_time_s=0.0 * four,
        lag_s=0.001 * four,
        natural_frequency_rad_per_s=natural_frequency * four,
        damping_ratio=damping * four,
        gain_positive_ratio=four,
        gain_negative_ratio=four,
        boom_from_dipper_ratio=np.zeros(1),
        dipper_from_boom_ratio=np.full(1, 0.0 if both else 0.9),
    )
    velocity, state = 0.0 * four, ResponseState(0.0 * four, 0.0 * four)
    fastest = 0.0
    for _ in range(400):
        velocity, state = respond(response, state, velocity, four, 0.0 * four, CONTROL_PERIOD_S)
        fastest = max(fastest, float(np.abs(velocity).max()))
    # Two coupled resonances with a gain of 1 / (2 damping) stay below 100; an unstable one exceeds 1e3.
    assert fastest < 100.0
