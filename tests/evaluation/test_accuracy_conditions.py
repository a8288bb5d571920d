"""Rows by pace and height, and the units' summary."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from evaluation.accuracy_report.accuracy_drawings import pace_plot
from evaluation.campaigns import Campaign, open_campaign
from evaluation.conditions import (
    condition_row,
    condition_rows,
    condition_table,
    height_rows,
    pace_rows,
    root_mean_square,
)
from machine.conventions import Mode
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult


def throw(
    down: float, cross: float = 0.0, outcome: ThrowOutcome = ThrowOutcome.LANDED
) -> ThrowResult:
    return ThrowResult(
        (9.0, 0.0, 0.0), outcome, (9.0 + down, cross, 0.0), down, cross, 3.0, 1.5, 2.5
    )


def swing_campaign(policies: Path, **changes: object) -> Campaign:
    campaign = open_campaign(
        mode=Mode.PLANAR, plant="twin", targets="6", throws=2, seed=0, unit_seed=0,
        policies=policies, policy=None, calibration=None, profile=None,
    )  # fmt: skip
    return campaign._replace(**changes)


def test_a_row_holds_what_landed_and_how_fast():
    thrown = [throw(0.1, 0.02), throw(-0.1, 0.04), throw(np.nan, np.nan, ThrowOutcome.COLLISION)]
    row = condition_row(9.0, 1.0, 0.5, thrown)
    assert (row.range_m, row.height_m, row.pace_ratio) == (9.0, 1.0, 0.5)
    assert (row.throw_count, row.landed_count) == (3, 2)
    assert row.mean_downrange_error_m == pytest.approx(0.0)
    assert row.sd_downrange_m == pytest.approx(np.sqrt(0.02))
    assert row.mean_crossrange_error_m == pytest.approx(0.03)
    assert (row.start_to_release_s, row.release_speed_m_per_s) == (1.5, 3.0)


def test_one_landing_has_no_spread_and_spoils_no_sum():
    alone = condition_row(9.0, 0.0, 0.0, [throw(0.2)])
    assert alone.sd_downrange_m is None
    rows = [condition_row(9.0, 0.0, 0.0, [throw(-d), throw(d)]) for d in (0.3, 0.4)] + [alone]
    # sd of (-d, d) is d sqrt 2; rms of 0.3 and 0.4 times that
    assert root_mean_square(rows, "sd_downrange_m") == pytest.approx(0.5)
    assert root_mean_square([alone], "sd_downrange_m") is None
    assert "-" in condition_table([alone]).splitlines()[1]
    assert "nan" not in pace_plot([alone], "w", by_speed=False) + pace_plot(
        rows, "w", by_speed=True
    )


def test_a_policy_is_asked_for_no_pace_and_no_height_that_it_does_not_know(swing_policies: Path):
    campaign = swing_campaign(swing_policies)
    assert pace_rows(campaign, 1, 0) == []
    policy = campaign.params.policy
    assert policy is not None
    lowest, highest = policy.card.target_height_min_m, policy.card.target_height_max_m
    rows = height_rows(campaign, 1, 0)
    assert rows and all(lowest <= row.height_m <= highest for row in rows)
    policy.card = policy.card.model_copy(
        update={"target_height_min_m": 0.0, "target_height_max_m": 0.0}
    )
    assert height_rows(campaign, 1, 0) == []


def test_places_out_of_reach_at_a_height_are_left_out(swing_policies: Path):
    campaign = swing_campaign(swing_policies, ranges_m=(6.0, 9.0), heights_m=(0.0, 1.0))
    assert campaign.places == [(6.0, 0.0), (9.0, 0.0), (6.0, 1.0), (9.0, 1.0)]
    policy = campaign.params.policy
    assert policy is not None
    lower = policy.card.model_copy(update={"reach_at_height_m": ((0.0, 9.5), (1.0, 8.0))})
    policy.card = lower
    assert campaign.places == [(6.0, 0.0), (9.0, 0.0), (6.0, 1.0)]


def test_a_campaign_throws_at_every_place(swing_policies: Path):
    rows = condition_rows(swing_campaign(swing_policies, heights_m=(0.0, 0.3)), 2, 4)
    assert [(r.range_m, r.height_m, r.throw_count) for r in rows] == [(6.0, 0.0, 2), (6.0, 0.3, 2)]


@pytest.mark.long
def test_units_are_registered_and_put_beside_unit_0(
    swing_policies: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """With a stand-in for registration: 160 throws a unit are not for a quick test."""
    seeds: list[int] = []

    def note(campaign: Campaign, seed: int) -> Campaign:
        seeds.append(seed)
        return campaign

    monkeypatch.setattr("evaluation.unit_accuracy.register_campaign", note)
    out = tmp_path / "units.json"
    words = [
        "units",
        "--mode",
        "2d",
        "--count",
        "1",
        "--throws",
        "3",
        "--targets",
        "6",
        "--seed",
        "2",
    ]
    assert main([*words, "--policies", str(swing_policies), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert sorted(found["units"]) == ["0", "2000"] and seeds == [2, 2]
    assert found["units"]["0"][0]["throw_count"] == 3
    assert 0.0 <= found["summary"]["landed share of the units"] <= 1.0


def test_units_refuse_numbers_that_are_none(capsys: pytest.CaptureFixture[str]):
    assert main(["units", "--mode", "2d", "--count", "0"]) == 1
    assert "--count 0" in capsys.readouterr().err
