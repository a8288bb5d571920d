import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from machine.errors import UsageError
from machine.spec import load_spec
from sim_twin.twin.profile import (
    TwinProfile,
    exact_profile,
    load_profile,
    nominal_profile,
    save_profile,
)
from tests.cases import each

SPEC = load_spec()
NOMINAL = nominal_profile(SPEC)


def test_nominal_profile_has_the_specs_values() -> None:
    assert NOMINAL.version_count == 0
    assert NOMINAL.dead_time_s == SPEC.response.dead_time_s
    assert NOMINAL.release_delay_s == SPEC.release.delay_s
    assert NOMINAL.drag_coefficient_ratio == SPEC.ball.drag_coefficient_ratio
    for w, z, lag in zip(
        NOMINAL.natural_frequency_rad_per_s,
        NOMINAL.damping_ratio,
        SPEC.response.lag_s,
        strict=True,
    ):
        # Mean delay of the second order (2 z / w) is that of the first-order lag.
        assert 2.0 * z / w == pytest.approx(lag)


@given(delay=st.floats(0.0, 1.0), drag=st.floats(0.0, 3.0), version=st.integers(0, 10_000))
def test_a_profile_survives_its_file_bit_by_bit(
    tmp_path_factory: pytest.TempPathFactory, delay: float, drag: float, version: int
) -> None:
    profile = NOMINAL.model_copy(
        update={
            "release_delay_s": delay,
            "drag_coefficient_ratio": drag,
            "version_count": version,
            "intervals": {"release_delay_s": (delay, delay + 0.1)},
        }
    )
    path = tmp_path_factory.mktemp("profile") / "m001.json"
    save_profile(profile, path)
    assert load_profile(path) == profile


def test_a_misspelt_effect_is_refused(tmp_path: Path) -> None:
    tree = NOMINAL.model_dump(mode="json")
    tree["relase_delay_s"] = 0.3
    path = tmp_path / "profile.json"
    path.write_text(json.dumps(tree))
    with pytest.raises(UsageError, match="relase_delay_s"):
        load_profile(path)


def test_a_missing_or_broken_file_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="leave --profile out"):
        load_profile(tmp_path / "none.json")
    (tmp_path / "half.json").write_text(NOMINAL.model_dump_json()[:100])
    with pytest.raises(UsageError, match="not a twin profile"):
        load_profile(tmp_path / "half.json")


@each(
    ("field", "value"),
    [
        ("dead_time_s", (-0.01, 0.1, 0.1, 0.1)),
        ("dead_time_s", (1.5, 0.1, 0.1, 0.1)),
        ("natural_frequency_rad_per_s", (0.0, 20.0, 20.0, 20.0)),
        ("release_delay_sd_s", -0.001),
        ("drag_coefficient_ratio", float("nan")),
        ("version_count", -1),
        ("intervals", {"no_such_effect": (0.0, 1.0)}),
        ("intervals", {"release_delay_s": (0.3, 0.2)}),
    ],
)
def test_impossible_values_are_refused(field: str, value: object) -> None:
    with pytest.raises(ValidationError):
        TwinProfile.model_validate({**NOMINAL.model_dump(), field: value})


def test_intervals_may_name_one_joint() -> None:
    profile = TwinProfile.model_validate(
        {**NOMINAL.model_dump(), "intervals": {"dead_time_s.slew": (0.1, 0.2)}}
    )
    assert profile.intervals["dead_time_s.slew"] == (0.1, 0.2)


def test_an_exact_profile_keeps_the_effects_and_drops_every_spread() -> None:
    exact = exact_profile(NOMINAL)
    assert exact.release_delay_s == NOMINAL.release_delay_s
    assert exact.release_delay_sd_s == 0.0
    spreads = [*exact.spread.model_dump().values(), *exact.noise.model_dump().values()]
    for spread in spreads:
        assert spread == 0.0 or all(value == 0.0 for value in spread)
