import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bulk.footprint import footprint, release_towards
from bulk.goal import pile_goal, progress, truck_goal
from bulk.height_field import Container, Rectangle, level_field, make_grid
from bulk.material import material
from bulk.planner import LoadPlanner
from bulk.simulation import Truth, planned_rule, simulate_job
from bulk.throw_model import (
    LandingScatter,
    MeasuredLoad,
    ThrowModel,
    learned_models,
    load_miss_m,
    measured_model,
)
from machine.conventions import Mode
from machine.errors import UsageError
from machine.policy_card import load_card
from machine.site.zones import Zone
from machine.spec import load_spec

ROOT = Path(__file__).parents[2]
POLICIES, RESULTS = ROOT / "policies", ROOT / "benchmarks" / "results"
CARD = load_card(POLICIES / "m545-2d-v7")
CARD_3D = load_card(POLICIES / "m545-3d-v7")
GRID = make_grid((4.0, 12.0), (-3.0, 3.0), 0.1)
BED = Container("truck", Rectangle(8.0, 0.0, 2.0, 2.0), 1.0, 0.6)
GRAVEL = material("gravel")


def throws(sd_m: float = 0.05) -> ThrowModel:
    scatter = [LandingScatter(7.0, sd_m, sd_m), LandingScatter(10.0, 2.0 * sd_m, sd_m)]
    return measured_model(CARD, load_spec(), GRAVEL, scatter, 1.2, 0.25)


def learned(known: ThrowModel, loads: list[MeasuredLoad]) -> ThrowModel:
    (model,) = learned_models([known], {}, {known.card.mode: loads})
    return model


def test_a_full_truck_needs_no_load():
    start = level_field(GRID, [BED])
    goal = truck_goal(start, 0, 1.0)
    full = replace(start, height_m=np.where(goal.region, 1.6, start.height_m))
    assert LoadPlanner(goal, start, [throws()], 0.25).next_loads(full) == ()


def test_wider_scatter_keeps_targets_away_from_the_walls():
    start = level_field(GRID, [BED])
    goal = truck_goal(start, 0, 1.0)
    exact, wild = (
        LoadPlanner(goal, start, [throws(sd_m)], 0.25).next_loads(start)[0] for sd_m in (0.01, 0.2)
    )
    assert wild.spill_ratio > exact.spill_ratio + 0.01


def test_mode_and_pace_are_those_that_spill_less_are_quicker_or_reach_at_all():
    start = level_field(GRID, [BED])
    goal = truck_goal(start, 0, 0.9)
    careful = throws()
    slow = replace(careful, pace_ratio=0.5, release_s=careful.release_s + 10.0)
    wild = replace(throws(0.3), pace_ratio=1.0, release_s=careful.release_s - 0.2)
    turning = replace(throws(0.04), card=CARD_3D)
    models = [wild, slow, careful]
    for load in LoadPlanner(goal, start, models, 0.25).next_loads(start):
        assert (load.mode, load.pace_ratio) == (Mode.PLANAR, careful.pace_ratio)
        assert re.search(
            r"2D at pace 0: spill risk .* \(2D at pace 0\.5: .* \+10\.0 s\)", load.sentence
        )
    (load, *_) = LoadPlanner(goal, start, [*models, turning], 0.25).next_loads(start)
    assert load.mode is Mode.SPATIAL and re.search(r"2D at pace 0: .* \+0\.0 s", load.others)
    moved = LoadPlanner(goal, start, [*models, turning], 0.25).load_at(start, 8.3, 0.2, 0.25)
    assert moved.mode is Mode.SPATIAL
    full = replace(start, height_m=np.where(goal.region, 1.6, start.height_m))
    harmful = LoadPlanner(goal, start, [careful, slow], 0.25).load_at(full, 8.3, 0.2, 0.25)
    assert harmful.cost > 0.0 and harmful.pace_ratio == careful.pace_ratio
    heavy = LoadPlanner(goal, start, [turning, careful], 0.6).load_at(start, 7.4, 0.0, 0.6)
    assert heavy.mode is Mode.PLANAR and heavy.others == "3D does not reach it"


def test_loads_of_its_own_pace_teach_a_model_more_than_others():
    slow, fast = throws(), replace(throws(), pace_ratio=1.0)
    grains = slow.grain_variance_m2()[0]
    loads = [
        MeasuredLoad(7.0, 0.0, (0.0, 0.0), (grains[0], grains[1])),
        *[MeasuredLoad(7.0, 0.9, (0.0, 0.0), (4.0 * grains[0], grains[1]))] * 40,
    ]
    known = learned_models([slow, fast], {}, {Mode.PLANAR: loads})
    ratios = [model.grain_variance_m2()[0, 0] / grains[0] for model in known]
    assert ratios[0] == pytest.approx(1.0) and ratios[1] > 3.0
    (other,) = learned_models([fast], {}, {Mode.PLANAR: loads[:1]})
    assert other.grain_variance_m2()[0] == pytest.approx(grains)
    usual_m = load_miss_m(Mode.PLANAR, 0.0, 0.0)
    scatter = {Mode.PLANAR: [LandingScatter(7.0, 2.0 * usual_m[0], usual_m[1])]}
    (wide,) = learned_models([slow], scatter, {})
    assert wide.landing_sd_m(7.0) == pytest.approx((0.1, 0.05))
    assert wide.landing_sd_m(10.0) == pytest.approx((0.2, 0.05))


def test_expected_misses_are_those_that_were_measured():
    rows = json.loads((RESULTS / "load_scatter.json").read_text(encoding="utf-8"))["rows"]
    assert len(rows) == 16
    for row in rows:
        labels, values = row["labels"], row["values"]
        mass_kg = 0.0 if labels["mass"] == "ball" else float(labels["mass"].removesuffix(" kg"))
        known = load_miss_m(Mode(labels["mode"].lower()), float(labels["pace"]), mass_kg)
        found = [values[f"rms_{axis}_m"]["value"] for axis in ("downrange", "crossrange")]
        assert known == pytest.approx(found, abs=0.006), labels
    slow, fast = (load_miss_m(Mode.SPATIAL, pace, 380.0)[0] for pace in (0.0, 1.0))
    assert load_miss_m(Mode.SPATIAL, 0.5, 380.0)[0] == pytest.approx(0.5 * (slow + fast))
    assert load_miss_m(Mode.SPATIAL, 0.0, 2000.0) == load_miss_m(Mode.SPATIAL, 0.0, 570.0)


def test_out_of_reach_and_zones_are_refused_with_numbers():
    far = Container("truck", Rectangle(8.0, 0.0, 2.0, 2.0), 3.5, 0.8)
    start = level_field(GRID, [far])
    with pytest.raises(UsageError, match=r"heights up to 4\.\d+ m.*heights of -1\.0 to 3\.0 m"):
        LoadPlanner(truck_goal(start, 0, 1.0), start, [throws()], 0.25)
    start = level_field(GRID, [BED])
    fence = Zone(
        name="path", reason="people walk", corners_m=((5.0, -3.0), (6.0, -3.0), (6.0, 3.0), (5.0, 3.0)),
        top_m=3.0,
    )  # fmt: skip
    with pytest.raises(UsageError, match="exclusion zone"):
        LoadPlanner(truck_goal(start, 0, 1.0), start, [throws()], 0.25, [fence])


def test_heavy_grabs_are_aimed_nearer_and_refused_where_none_reaches():
    start = level_field(GRID)
    goal = pile_goal(start, Rectangle(9.0, 0.0, 4.0, 2.0), 1.0, 0.7)
    light, heavy = (
        LoadPlanner(goal, start, [throws()], volume_m3).reachable(start.height_m, volume_m3)
        for volume_m3 in (0.05, 0.5)
    )
    assert 0 < heavy.sum() < light.sum()
    loads = LoadPlanner(goal, start, [throws()], 0.5).next_loads(start)
    for load in loads:
        reach = throws().farthest_m(load.z_m, load.volume_m3)
        assert math.hypot(load.x_m, load.y_m) <= reach + 1e-9
    with pytest.raises(UsageError, match=r"with 1520 kg of gravel .* reaches no target there"):
        LoadPlanner(goal, start, [throws()], 2.0)


def test_a_simulated_truck_is_filled_and_its_volume_closes():
    start = level_field(GRID, [BED])
    goal = truck_goal(start, 0, 0.95)
    planner = LoadPlanner(goal, start, [throws()], 0.3)
    truth = Truth(0.9 * GRAVEL.slope_ratio, (0.05, 0.0))
    run = simulate_job(
        goal, start, [throws()], planned_rule(planner), truth, np.random.default_rng(1)
    )
    end = run.loads[-1].after
    assert end.filled_ratio > 0.8
    assert end.spill_ratio < 0.03
    assert run.final.volume_m3() == pytest.approx(run.thrown_m3, rel=1e-9)
    assert len(run.versions) == len(run.loads)
    assert (run.versions[0] == start.height_m).all()


def test_measured_loads_widen_or_narrow_what_is_expected_the_more_of_them_there_are():
    known = throws()
    there = np.array([8.0]), np.array([0.0])
    before = known.covariance_m2(*there)[0]
    grains = np.diagonal(known.footprint_near(8.0).covariance_m2)
    wide = [MeasuredLoad(8.0, 0.0, (0.3, -0.3), (4.0 * grains[0], grains[1])) for _ in range(40)]
    assert (learned(known, []).landing_variance_m2 == known.landing_variance_m2).all()
    few, many = (learned(known, wide[:n]).covariance_m2(*there)[0] for n in (2, 40))
    assert before[0, 0] < few[0, 0] < many[0, 0]
    assert many[0, 0] == pytest.approx(4.0 * grains[0] + 0.09, rel=0.15)
    assert many[1, 1] == pytest.approx(grains[1] + 0.09, rel=0.15)
    narrow = [MeasuredLoad(8.0, 0.0, (0.0, 0.0), (0.25 * grains[0], 0.25 * grains[1]))] * 40
    assert (np.diagonal(learned(known, narrow).covariance_m2(*there)[0]) < 0.4 * before.max()).all()
    mark = learned(known, wide).footprint_near(8.0)
    assert np.cov(mark.grains_m.T) == pytest.approx(mark.covariance_m2)


def test_a_wider_footprint_spills_more():
    start = level_field(GRID, [BED])
    goal = truck_goal(start, 0, 0.9)
    known = throws()
    variances = tuple(4.0 * np.diagonal(known.footprint_near(8.0).covariance_m2))
    wide = learned(known, [MeasuredLoad(8.0, 0.0, (0.0, 0.0), variances)] * 20)
    spills = [
        LoadPlanner(goal, start, [model], 0.2).load_at(start, 8.6, 0.5, 0.2).spill_ratio
        for model in (known, wide)
    ]
    assert 0.0 <= spills[0] < 0.5 * spills[1]


def test_a_heap_is_cleared_into_a_box():
    heap = Rectangle(5.0, 0.0, 1.6, 1.6)
    start = level_field(GRID, [BED]).pour(np.array([[5.0, 0.0]]), 0.3, GRAVEL.slope_ratio)
    goal = truck_goal(start, 0, 0.9, heap)
    planner = LoadPlanner(goal, start, [throws()], 0.2)
    truth = Truth(GRAVEL.slope_ratio)
    run = simulate_job(
        goal, start, [throws()], planned_rule(planner), truth, np.random.default_rng(1)
    )
    assert run.final.volume_m3(goal.heap) < 0.05
    assert run.final.volume_m3() == pytest.approx(start.volume_m3(), rel=1e-9)


def test_a_pile_goal_has_sides_at_the_angle_of_repose():
    start = level_field(GRID)
    goal = pile_goal(start, Rectangle(8.0, 0.0, 4.0, 3.0), 5.0, 0.7)
    assert goal.wanted_m.max() == pytest.approx(0.7 * 1.5, abs=0.08)
    state = progress(goal, start, start)
    assert state.filled_ratio == 0.0 and state.missing_m3 == pytest.approx(state.wanted_m3)


def test_grains_spread_more_on_longer_throws_and_start_from_the_aim():
    spec, rng = load_spec(), np.random.default_rng(0)
    near, far = (
        footprint(release_towards(r, 0.0), 0.0, GRAVEL, 0.25, spec, rng).covariance_m2
        for r in (6.5, 10.0)
    )
    assert far[0, 0] > near[0, 0] > 0.0
    mark = footprint(release_towards(8.0, 0.0), 0.0, GRAVEL, 0.25, spec, rng)
    assert np.abs(mark.grains_m.mean(axis=0)).max() < 1e-9
    turned = throws().covariance_m2(np.array([8.0, 0.0]), np.array([0.0, 8.0]))
    assert turned[1] == pytest.approx(turned[0][::-1, ::-1] * np.array([[1, -1], [-1, 1]]))
    assert math.isfinite(turned.sum())
