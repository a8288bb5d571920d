"""The table of effects as data: names, bounds, units, profiles that hold effects."""

import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from machine.conventions import ACTIVE_JOINTS, UNIT_SUFFIXES
from machine.errors import UsageError
from machine.spec import load_spec
from sim_twin.effects.arrays import effect_arrays
from sim_twin.effects.effect import Effect, acting_effect, deterministic, effect_stage, resolve
from sim_twin.effects.schema import DRIFT, parameter_unit
from sim_twin.effects.table import EFFECTS, effects_where
from sim_twin.twin.profile import (
    TwinProfile,
    exact_profile,
    load_profile,
    nominal_profile,
    save_profile,
)
from tests.cases import each

NOMINAL = nominal_profile(load_spec())
DELAY = Effect(effect="valve_dead_time", joint="boom", parameters={"extra_dead_time_s": 0.05})
WIND = Effect(effect="wind", parameters={"x_m_per_s": 2.0, "y_m_per_s": -1.0})


def drift(name: str, size: float, joint: str | None = None) -> Effect:
    return Effect(effect=DRIFT, joint=joint, parameters={name: size})


def test_every_row_is_complete_and_consistent() -> None:
    for name, spec in EFFECTS.items():
        assert spec.name == name
        assert set(spec.joints) <= set(ACTIVE_JOINTS), name
        assert spec.physics, name
        assert spec.source, name
        assert len({p.name for p in spec.parameters}) == len(spec.parameters), name
        for p in spec.parameters:
            assert p.name.endswith(UNIT_SUFFIXES), (name, p.name)
            assert p.low <= 0.0 < p.high, "0 is no effect"
            assert p.low <= (p.virtual_low or p.low) <= 0.0
            assert p.low <= p.step <= p.high, "the finite difference can be taken"
            assert 0.0 < p.tolerance < p.prior_sd
            assert p.tolerance <= p.step <= 4.0 * p.prior_sd


def test_columns_agree_with_each_other() -> None:
    joints = {"joint_sensor"}
    for name in effects_where(lambda e: bool(e.joints)):
        assert EFFECTS[name].part in {"drive", *joints}, name
    # What moves no mean, and what is compared with the switch alone, needs no replay.
    assert effects_where(lambda e: not e.replays) == ("release_delay", "release_jitter")
    assert effects_where(lambda e: e.is_random) == ("release_jitter",)
    assert effects_where(lambda e: e.stage == "actuation") == effects_where(
        lambda e: e.part == "drive"
    )
    assert set(effects_where(lambda e: e.stops_joint)) < set(
        effects_where(lambda e: not e.is_smooth)
    )
    assert set(effects_where(lambda e: e.hides_drift)) < set(effects_where(lambda e: e.can_drift))
    assert DRIFT not in effects_where(lambda _: True)
    assert set(effects_where(lambda _: True)) == EFFECTS.keys() - {DRIFT}


REFUSED: tuple[tuple[str, str | None, dict[str, float], str], ...] = (
    ("valve_delay", "boom", {"extra_dead_time_s": 0.1}, "no effect 'valve_delay'"),
    ("valve_dead_time", "roll", {"extra_dead_time_s": 0.1}, "name one of slew, boom"),
    ("valve_dead_time", None, {"extra_dead_time_s": 0.1}, "name one of slew, boom"),
    ("valve_dead_time", "boom", {"dead_time_s": 0.1}, "it has extra_dead_time_s"),
    ("valve_dead_time", "boom", {"extra_dead_time_s": 0.31}, "0.31 is outside -0.1 to 0.3"),
    ("valve_dead_time", "boom", {"extra_dead_time_s": float("nan")}, "finite"),
    ("wind", "boom", {"x_m_per_s": 1.0}, "whole machine"),
    (DRIFT, "boom", {"extra_dead_time_s": 0.1}, "no parameter"),
    (DRIFT, None, {"valve_dead_time.extra_dead_time_s": 0.1}, "name one of slew"),
    (DRIFT, None, {"wind.x_m_per_s": 1.0, "wind.y_m_per_s": 1.0}, "exactly one"),
)
"""Effect, joint and parameters that are refused, and what the message says."""


def test_effects_outside_the_table_are_refused() -> None:
    for effect, joint, parameters, message in REFUSED:
        with pytest.raises(ValidationError, match=message):
            Effect(effect=effect, joint=joint, parameters=parameters)


def test_a_value_at_a_bound_is_inside_whatever_rounding_does() -> None:
    Effect(effect="valve_dead_time", joint="boom", parameters={"extra_dead_time_s": 0.1 + 0.2})


def test_equal_effects_add_up_and_drifts_follow_the_throws_place() -> None:
    change = drift("valve_dead_time.extra_dead_time_s", 0.1, "boom")
    key = ("valve_dead_time", "boom", "extra_dead_time_s")
    for place, size in ((0.0, 0.10), (0.5, 0.15), (1.0, 0.20)):
        assert resolve([DELAY, DELAY, change], place)[key] == pytest.approx(size)


def test_a_drift_belongs_to_the_stage_of_what_it_changes() -> None:
    assert effect_stage(DELAY) == "actuation"
    assert effect_stage(drift("wind.x_m_per_s", 1.0)) == "flight"
    assert acting_effect(drift("wind.x_m_per_s", 1.0)) == "wind"


def test_only_jitter_is_random() -> None:
    jitter = Effect(effect="release_jitter", parameters={"extra_sd_s": 0.02})
    drifting = drift("release_jitter.extra_sd_s", 0.02)
    assert deterministic([DELAY, jitter, drifting, WIND]) == (DELAY, WIND)
    profile = NOMINAL.model_copy(update={"effects": (jitter, WIND)})
    assert exact_profile(profile).effects == (WIND,)


def test_units_follow_the_names_and_the_telescope_is_linear() -> None:
    assert parameter_unit("extra_dead_time_s") == "s"
    assert parameter_unit("gap_rad_m", "boom") == "rad"
    assert parameter_unit("gap_rad_m", "telescope") == "m"
    assert parameter_unit("breakaway_rad_m_per_s", "telescope") == "m/s"
    assert parameter_unit("extra_coulomb_rad_per_s2") == "rad/s2"
    assert parameter_unit("extra_inertia_ratio") == "1"
    with pytest.raises(KeyError, match="leak_litres"):
        parameter_unit("leak_litres")


def test_sets_of_effects_become_arrays_and_nothing_becomes_none() -> None:
    assert effect_arrays(3, (), None, 0.0) is None
    assert effect_arrays(2, (), [(), ()], 0.0) is None
    arrays = effect_arrays(2, (WIND,), [(DELAY,), ()], 0.0)
    assert arrays is not None
    delay = arrays.get("valve_dead_time", "extra_dead_time_s")
    assert delay is not None
    assert delay.tolist() == [[0.0, 0.05, 0.0, 0.0], [0.0] * 4]
    assert arrays.filled("wind", "x_m_per_s").tolist() == [2.0, 2.0]
    assert arrays.get("valve_lag", "extra_lag_s") is None
    assert arrays.acts_in("flight")
    assert not arrays.acts_in("swing")
    assert arrays.acts_on("air", "base")
    assert not arrays.acts_on("base")


def test_a_profile_with_effects_survives_its_file(tmp_path: Path) -> None:
    profile = TwinProfile.model_validate(
        {
            **NOMINAL.model_dump(),
            "effects": (DELAY, WIND, drift("wind.x_m_per_s", 0.1 + 0.2)),
            "intervals": {
                "valve_dead_time.boom.extra_dead_time_s": (0.04, 0.06),
                "wind.x_m_per_s": (1.5, 2.5),
            },
        }
    )
    save_profile(profile, tmp_path / "m001.json")
    again = load_profile(tmp_path / "m001.json")
    assert again == profile
    assert [hash(e) for e in again.effects] == [hash(e) for e in profile.effects]


def test_a_profile_of_version_one_is_read_as_one_without_effects(tmp_path: Path) -> None:
    tree = NOMINAL.model_dump(mode="json")
    tree["schema_version"] = 1
    del tree["effects"]
    path = tmp_path / "old.json"
    path.write_text(json.dumps(tree))
    assert load_profile(path) == NOMINAL
    assert NOMINAL.schema_version == 3


@each(
    ("change", "message"),
    [
        ({"effects": [{"effect": "magic", "parameters": {}}]}, "no effect 'magic'"),
        ({"intervals": {"wind.x_m_per_s": (0.0, 1.0)}}, "names no effect"),
        ({"schema_version": 4}, "schema_version"),
    ],
)
def test_a_profile_refuses_what_it_does_not_know(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = tmp_path / "profile.json"
    path.write_text(json.dumps({**NOMINAL.model_dump(mode="json"), **change}))
    with pytest.raises(UsageError, match=message):
        load_profile(path)
