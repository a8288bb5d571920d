"""Policy folders that are incomplete or were changed are refused with the reason."""

import json

import pytest

from machine.conventions import Mode
from machine.errors import PolicyError, RefusedError, UsageError
from machine.messages import RejectReason, Target
from machine.policy_card import (
    CARD_FILE,
    POLICY_FILE,
    PolicyCard,
    add_evaluation,
    file_sha256,
    load_card,
)
from machine.reach import check_pace, check_target
from tests.cases import each


def make_card(sha: str, **changes) -> PolicyCard:
    fields = {
        "policy_id": "test-2d",
        "mode": Mode.PLANAR,
        "policy_sha256": sha,
        "model_sha256": "b" * 64,
        "observation_names": ("a",),
        "action_names": ("u",),
        "action_scale_rad_m_per_s": (1.0,),
        "target_range_min_m": 6.0,
        "target_range_max_m": 10.87,
        "training": {
            "commit": "x",
            "seed_count": 0,
            "environment_step_count": 1,
            "iteration_count": 1,
            "wall_s": 1.0,
            "device": "cpu",
            "config": {},
        },
    }
    return PolicyCard.model_validate(fields | changes)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / POLICY_FILE).write_bytes(b"weights")
    card = make_card(file_sha256(tmp_path / POLICY_FILE))
    (tmp_path / CARD_FILE).write_text(card.model_dump_json())
    return tmp_path


def test_a_whole_folder_loads(folder):
    assert load_card(folder).policy_id == "test-2d"


@each("name", [POLICY_FILE, CARD_FILE], copied="folder")
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(PolicyError, match=name):
        load_card(folder)


def test_a_cut_off_policy_file_is_noticed(folder):
    (folder / POLICY_FILE).write_bytes(b"weigh")
    with pytest.raises(PolicyError, match="changed or cut off"):
        load_card(folder)


def test_a_card_with_a_missing_field_is_refused(folder):
    tree = json.loads((folder / CARD_FILE).read_text())
    del tree["mode"]
    (folder / CARD_FILE).write_text(json.dumps(tree))
    with pytest.raises(PolicyError, match="mode"):
        load_card(folder)


@each(
    ("target", "reason"),
    [
        (Target(x_m=11.4, y_m=0.0), RejectReason.TARGET_OUT_OF_REACH),
        (Target(x_m=0.0, y_m=10.871), RejectReason.TARGET_OUT_OF_REACH),
        (Target(x_m=5.99, y_m=0.0), RejectReason.TARGET_TOO_NEAR),
        (Target(x_m=-1.0, y_m=0.5), RejectReason.TARGET_TOO_NEAR),
        (Target(x_m=9.0, y_m=0.0, z_m=0.3), RejectReason.TARGET_OUT_OF_REACH),
    ],
)
def test_targets_the_policy_was_not_made_for_are_refused(target, reason):
    with pytest.raises(RefusedError, match=r"\d") as refused:
        check_target(make_card("a"), target)
    assert refused.value.reason is reason


def test_the_reach_falls_with_the_height():
    card = make_card(
        "a",
        target_height_min_m=-1.0,
        target_height_max_m=3.0,
        reach_at_height_m=((-1.0, 10.9), (1.0, 10.4), (3.0, 8.2)),
    )
    check_target(card, Target(x_m=10.87, y_m=0.0, z_m=-1.0))
    check_target(card, Target(x_m=9.3, y_m=0.0, z_m=2.0))
    with pytest.raises(RefusedError, match=r"9\.40 m.*reaches 9\.30 m at height \+2\.00 m"):
        check_target(card, Target(x_m=9.4, y_m=0.0, z_m=2.0))
    check_target(card, Target(x_m=8.3, y_m=0.0, z_m=2.0), load_kg=380.0)
    with pytest.raises(
        RefusedError, match=r"9\.20 m, 2D reaches 8\.60 m at height \+2\.00 m with 380 kg"
    ):
        check_target(card, Target(x_m=9.2, y_m=0.0, z_m=2.0), load_kg=380.0)
    with pytest.raises(RefusedError, match=r"2D reaches no target at height .* with 4000 kg"):
        check_target(card, Target(x_m=9.2, y_m=0.0, z_m=2.0), load_kg=4000.0)
    with pytest.raises(RefusedError, match=r"heights of -1\.00 to \+3\.00"):
        check_target(card, Target(x_m=7.0, y_m=0.0, z_m=3.1))


@each("pace", [-0.1, 1.1, float("nan")])
def test_a_pace_beyond_careful_and_fast_is_refused(pace):
    with pytest.raises(UsageError, match=r"between 0 \(careful\) and 1 \(fast\)"):
        check_pace(pace)


@each(("x_m", "y_m"), [(-9.0, 0.0), (6.0, 0.0), (10.87, 0.0), (0.0, -8.0)])
def test_targets_within_reach_pass_in_any_direction(x_m, y_m):
    check_target(make_card("a"), Target(x_m=x_m, y_m=y_m))


def test_an_evaluation_takes_the_place_of_the_last_one_on_the_same_plant(folder) -> None:
    sha = file_sha256(folder / POLICY_FILE)
    made = make_card(sha, evaluation=[{"plant": "training"}])
    (folder / CARD_FILE).write_text(made.model_dump_json())
    add_evaluation(folder, {"plant": "virtual", "unit_seed": 0, "seed": 1})
    add_evaluation(folder, {"plant": "virtual", "unit_seed": 5, "seed": 1})
    add_evaluation(folder, {"plant": "virtual", "unit_seed": 0, "seed": 2})
    assert load_card(folder).evaluation == [
        {"plant": "training"},
        {"plant": "virtual", "unit_seed": 5, "seed": 1},
        {"plant": "virtual", "unit_seed": 0, "seed": 2},
    ]
    assert load_card(folder).policy_sha256 == sha


@each("number", ["NaN", "Infinity", "-Infinity", "1e999"], copied="folder")
@each("place", ["target_range_min_m", "config", "evaluation"], copied="folder")
def test_numbers_that_are_not_finite_are_refused(folder, number, place):
    body = json.loads((folder / CARD_FILE).read_text())
    if place == "config":
        body["training"]["config"] = {"rate": "HERE"}
    else:
        body[place] = [{"mean": "HERE"}] if place == "evaluation" else "HERE"
    (folder / CARD_FILE).write_text(json.dumps(body).replace('"HERE"', number))
    with pytest.raises(PolicyError, match="is no finite number"):
        load_card(folder)


def test_a_deeply_nested_card_is_refused(folder):
    (folder / CARD_FILE).write_text('{"evaluation": ' + "[" * 100_000)
    with pytest.raises(PolicyError, match="is not a policy card"):
        load_card(folder)


def test_a_card_in_another_encoding_is_refused(folder):
    text = (folder / CARD_FILE).read_text(encoding="utf-8")
    (folder / CARD_FILE).write_bytes(text.encode("utf-16"))
    with pytest.raises(PolicyError, match="is no text in UTF-8"):
        load_card(folder)
