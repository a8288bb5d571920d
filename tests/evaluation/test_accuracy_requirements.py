"""What holds accuracy back: parts of a spread come back as planted, goals are by range, causes in order."""

import numpy as np
import pytest

from evaluation.accuracy_report.accuracy_page import accuracy_html
from evaluation.accuracy_report.error_budget import error_budget
from evaluation.conditions import condition_row
from evaluation.measures import (
    Estimate,
    ModeEvaluation,
    TrainingRow,
    UnitRow,
    target_row,
)
from evaluation.requirements import (
    check_requirements,
    examined_range_m,
    requirement_at,
    unmet_fields,
)
from evaluation.sensitivity import FactorShift
from evaluation.spread import spread_parts
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult


def throw(down, cross=0.0, outcome=ThrowOutcome.LANDED):
    return ThrowResult((9.0, 0.0, 0.0), outcome, (0.0,) * 3, down, cross, 3.0, 1.5, 3.0)


def repeated(rng, starts, repeats, between_m, within_m):
    centre = between_m * rng.standard_normal(starts)
    return [[throw(c + within_m * rng.standard_normal()) for _ in range(repeats)] for c in centre]


def test_a_planted_spread_is_split_into_its_parts():
    rng = np.random.default_rng(0)
    found = spread_parts(9.0, repeated(rng, 600, 4, 0.09, 0.05))
    assert found.between_starts_downrange_m == pytest.approx(0.09, rel=0.1)
    assert found.within_start_downrange_m == pytest.approx(0.05, rel=0.05)
    assert found.within_start_crossrange_m == 0.0
    alone = spread_parts(9.0, repeated(rng, 600, 4, 0.0, 0.05))
    assert alone.between_starts_downrange_m < 0.02


def test_throws_that_did_not_land_are_left_out_and_one_start_is_none():
    bad = throw(np.nan, np.nan, ThrowOutcome.COLLISION)
    found = spread_parts(9.0, [[throw(0.1), throw(0.1), bad], [throw(0.3), throw(0.3)], [bad, bad]])
    assert (found.start_count, found.throw_count) == (2, 4)
    assert found.between_starts_downrange_m == pytest.approx(0.1 * 2**0.5)
    assert spread_parts(9.0, [[throw(0.1), throw(0.2)], [throw(0.1)]]) is None


def test_goals_grow_with_the_range_and_end():
    assert (
        requirement_at("2d", 9.5).sd_m
        < requirement_at("2d", 9.6).sd_m
        < requirement_at("2d", 10.87).sd_m
    )
    assert requirement_at("3d", 11.0) is None
    good = target_row(9.0, [throw(0.01), throw(-0.02), throw(0.03)])
    assert list(unmet_fields("2d", good)) == []
    bad = target_row(9.0, [throw(0.2, 0.1), throw(0.0, 0.1), throw(0.4, 0.1)])
    assert list(unmet_fields("2d", bad)) == [
        "mean_downrange_error_m",
        "mean_crossrange_error_m",
        "sd_downrange_m",
    ]
    nothing = target_row(9.0, [throw(np.nan, np.nan, ThrowOutcome.COLLISION)])
    assert len(list(unmet_fields("2d", nothing))) == 4
    assert list(unmet_fields("2d", target_row(12.0, [throw(1.0), throw(-1.0)]))) == []


def test_causes_are_looked_for_where_a_figure_is_exceeded_most():
    near = target_row(8.0, [throw(0.01), throw(-0.02), throw(0.03)])
    nine = target_row(9.5, [throw(0.01), throw(-0.01)])
    assert examined_range_m("2d", [near, nine]) == 9.5
    wide = target_row(7.5, [throw(0.2), throw(-0.2)])
    assert examined_range_m("2d", [wide, near, nine]) == 7.5
    # 2.5 times the spread that is asked at 10.87 m is less than 3.5 times the one at 7.5 m.
    far = target_row(10.87, [throw(0.44), throw(-0.44)])
    assert examined_range_m("2d", [wide, near, far]) == 7.5


def evaluation(**more):
    results = [throw(0.02), throw(0.06), throw(0.04)]
    known = {
        "mode": "2d", "plant": "virtual", "unit_seed": 0, "policy": "p", "seed": 1, "seconds": 1.0,
        "real_time_factor": 9.0, "outcomes": {"landed": 3}, "targets": (target_row(9.0, results),),
        "start_to_release_s": Estimate(value=1.5, ci95=None),
        "start_to_landing_s": Estimate(value=3.0, ci95=None), "failures": (),
        "sensitivity_range_m": 9.0, "sensitivity_note": "3 throws a run.",
        "sensitivity": (FactorShift(name="dead time", change="-/+ 20 ms", low_m=-0.1, high_m=0.12,
                                    plain_sd_m=0.02, low_sd_m=0.02, high_sd_m=0.03, pair_count=3,
                                    failed_count=0),),
        "spread": spread_parts(9.0, [[throw(0.0), throw(0.02)], [throw(0.3), throw(0.32)]]),
    }  # fmt: skip
    return ModeEvaluation.model_validate({**known, **more})


def test_the_largest_cause_comes_first_and_the_page_names_it():
    part = evaluation()
    found = error_budget(part)
    assert [cause.name for cause in found] == [
        "start pose",
        "dead time, off by 20 ms",
        "bias left by policy and registration",
        "random variation: release, valves, sensors",
    ]
    assert found[1].size_m == pytest.approx(0.11)
    html = accuracy_html([part], 7.5)
    assert "largest cause of error is <b>start pose</b>" in html
    assert "0.020, 0.020, 0.030 m" in html
    assert "Machines outside training" in html
    assert "Comparison of trainings" not in html


def test_what_is_asked_is_judged_by_its_worst_figure():
    near = target_row(9.0, [throw(0.01, 0.1), throw(-0.01, -0.1), throw(0.0, 0.0)])
    lost = target_row(
        10.87, [throw(0.3), throw(-0.1), throw(np.nan, np.nan, ThrowOutcome.COLLISION)]
    )
    alone = evaluation(targets=(near, lost))
    words = {v.name: (v.is_met, v.where) for v in check_requirements(alone)}
    assert words == {
        "standard deviation, 9 m": (False, "crossrange at 9 m"),
        "mean error, 9 m": (True, "downrange at 9 m"),
        # Nothing is asked of the mean at 10.87 m, which is 0.1 m here.
        "standard deviation, 10.87 m": (False, "downrange at 10.87 m"),
        "throws that land": (False, "least at 10.87 m: 2 of 3"),
    }
    html = accuracy_html([alone], 7.5)
    assert "1 of 4 requirements are met. Not met: 2D, standard deviation, 9 m;" in " ".join(
        html.split()
    )
    assert "83.3 %" in html


def test_machines_never_seen_are_judged_against_what_is_asked_and_against_the_nominal_one():
    row = condition_row(9.0, 0.0, 0.0, [throw(0.0), throw(0.1)])
    units = tuple(
        UnitRow(unit_seed=u, landed_count=2, throw_count=2, mean_downrange_error_m=0.0, sd_downrange_m=s,
                mean_crossrange_error_m=0.0, sd_crossrange_m=0.01, targets=(row,))
        for u, s in ((0, 0.04), (2000, 0.05), (2001, 0.07))
    )  # fmt: skip
    asked, beside = check_requirements(evaluation(units=units))[-2:]
    assert asked.worst == pytest.approx(0.1 / 2**0.5 / 0.08)
    assert asked.is_met
    assert (beside.worst, beside.where) == (pytest.approx(1.75), "machine 2001, downrange")
    assert not beside.is_met


def test_units_and_trainings_have_their_tables():
    row = condition_row(9.0, 0.0, 0.0, [throw(0.0), throw(0.1)])
    units = tuple(
        UnitRow(unit_seed=u, landed_count=2, throw_count=2, mean_downrange_error_m=m,
                sd_downrange_m=s, mean_crossrange_error_m=0.0, sd_crossrange_m=0.01)
        for u, m, s in ((0, 0.01, 0.05), (1000, 0.4, 0.10), (1001, 0.4, 0.06))
    )  # fmt: skip
    training = TrainingRow(policy="p-s1", training_seed=1, step_count=630_000_000, row=row)
    part = evaluation(units=units, trainings=(training,))
    assert error_budget(part)[0].name == "another machine of the type, registered"
    html = accuracy_html([part], 7.5)
    assert "Spread downrange over unit 0's" in html
    assert "median 1.60, worst 2.00; limit: 1.50, exceeded by 1000." in html
    assert "Spread crossrange" in html and "worst 1.00; limit: 1.50, kept by all." in html
    assert "0.63e9" in html
