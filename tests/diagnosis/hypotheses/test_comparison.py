"""Evidence of sets of effects, and of their subsets, is comparable."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.healthy.noise import load_noise
from diagnosis.hypotheses import candidates, comparison, exploration, generation, refinement
from diagnosis.hypotheses.candidates import sizes_in
from diagnosis.hypotheses.comparison import (
    CandidateSet,
    better,
    comparable_evidence,
    evidence_at_simulated,
    evidence_in,
    extrapolated_gain,
    local_evidence,
    with_model_error,
)
from diagnosis.hypotheses.generation import (
    clear_partner_joints,
    missing_lookalikes,
    missing_subsets,
    most_promising,
)
from diagnosis.hypotheses.refinement import large_enough
from diagnosis.inference.evidence import Priors, inform, screen
from diagnosis.linearisation.parameters import layout
from diagnosis.tuning import PART_LOG_ODDS
from machine.spec import load_spec
from sim_twin.twin.profile import nominal_profile

SIZES = np.array([3.0, 0.6])
PRIORS = Priors(
    scatter=1e-6 * np.eye(3),
    slab_sd=np.ones(3),
    low=np.full(3, -10.0),
    high=np.full(3, 10.0),
    groups=tuple(np.array([i]) for i in range(3)),
    log_prior=np.full(3, -6.0),
)


def data():
    """A large effect, a small one, and a third parameter that looks like the small one."""
    rng = np.random.default_rng(5)
    slopes, _ = np.linalg.qr(rng.normal(size=(400, 3)))
    slopes *= 20.0
    slopes[:, 2] = slopes[:, 1] + 0.1 * slopes[:, 2]
    residual = slopes[:, :2] @ SIZES + rng.normal(size=400)
    return inform(residual, slopes, np.zeros((400, 0)))


def candidate(members=(), sizes=None, jumping=()):
    sizes = np.zeros(0) if sizes is None else sizes
    informed = data()
    priors = with_model_error(PRIORS, informed, members, sizes) if members else PRIORS
    base = screen(informed, priors)
    return CandidateSet(members, sizes, sizes, {}, [informed], priors, PRIORS, base, jumping)


def compared(*candidates):
    evaluated = [(i, t.members) for i, t in enumerate(candidates)]
    found = comparable_evidence(candidates, evaluated, [t.information[0] for t in candidates])
    return dict(zip((t.members for t in candidates), found, strict=True))


def test_a_subset_has_the_model_error_of_its_own_effects_only():
    both, one = candidate((0, 1), SIZES), candidate((0,), SIZES[:1])
    found = compared(candidate(), both, one)
    assert found[0, 1] - found[0,] > 40.0
    borrowed = evidence_in(both.base, PRIORS, (0,))
    assert found[0, 1] - borrowed < 30.0, "with the form error of both"


def test_gain_at_sizes_that_were_not_simulated_is_extrapolated():
    near = candidate((0,), SIZES[:1])
    far = replace(near, at=np.array([1.0]))
    assert extrapolated_gain(candidate()) == extrapolated_gain(near) == 0.0
    assert local_evidence(far) == local_evidence(near)
    assert evidence_at_simulated(far) < evidence_at_simulated(near) - 100.0
    beyond = replace(near, sizes=np.array([12.0]), at=np.array([10.0]))
    assert extrapolated_gain(beyond) == 0.0, "it was simulated as far as the bound lets it"
    assert extrapolated_gain(replace(far, jumping=(0,))) == 0.0


def test_extrapolated_gain_does_not_count_in_the_end():
    near = candidate((0,), SIZES[:1])
    candidates = candidate(), replace(near, at=np.array([1.0]))
    evaluated = [(0, ()), (1, (0,))]
    data = [t.information[0] for t in candidates]
    found = comparable_evidence(candidates, evaluated, data)
    last = comparable_evidence(candidates, evaluated, data, is_last=True)
    assert found[1] - last[1] == pytest.approx(extrapolated_gain(candidates[1]))
    assert found[0] == last[0]


def test_model_error_is_per_stage():
    groups, priors = layout(load_noise()).groups, layout(load_noise()).priors
    aim = groups.index(("base_yaw_drift", None))
    place = int(priors.groups[aim][0])
    precision = np.eye(priors.slab_sd.size)
    other = int(priors.groups[groups.index(("payload_mass", None))][0])
    precision[place, other] = precision[other, place] = 1.0
    informed = data()._replace(precision=precision)
    alone = with_model_error(priors, informed, (aim,), np.array([1.0])).scatter
    dead = groups.index(("valve_dead_time", "boom"))
    with_drive = with_model_error(priors, informed, (dead, aim), np.array([1.0, 1.0])).scatter
    assert alone[other, other] > priors.scatter[other, other]
    assert with_drive[other, other] == pytest.approx(alone[other, other])


def test_effects_that_do_not_extrapolate_favour_no_subset():
    both, one = candidate((0, 1), SIZES), candidate((0,), 0.5 * SIZES[:1])
    smooth = compared(candidate(), both, one)
    jumping = compared(candidate(), candidate((0, 1), SIZES, jumping=(1,)), one)
    assert jumping[0,] == pytest.approx(evidence_in(one.base, one.priors, (0,)))
    assert smooth[0, 1] == pytest.approx(jumping[0, 1])
    curved = compared(candidate(), replace(candidate((0, 1), SIZES), curved=(1,)), one)
    assert curved == jumping, "lift grows along a curve"
    kept = compared(candidate(), replace(candidate((0, 1), SIZES), curved=(0,)), one)
    assert kept == smooth, "a part that has it"


def test_the_gain_of_a_subset_is_bounded():
    both, one = candidate((0, 1), SIZES), candidate((0,), SIZES[:1])
    lost = one.information[0]._replace(log_volume=one.information[0].log_volume + 500.0)
    poor = replace(one, information=[lost])
    own = evidence_in(screen(lost, one.priors), one.priors, (0,))
    assert compared(candidate(), both, poor)[0,] == pytest.approx(own + PART_LOG_ODDS)
    excited = compared(candidate(), replace(both, excites_others=True), poor)
    assert (
        excited[0,]
        == compared(candidate(), replace(both, excites_others=True), one)[0,]
        > own + 400.0
    )


@pytest.mark.parametrize(
    ("scatter_sd", "at_ratio", "also", "is_scatter"),
    [
        (2.0, 1.0, {}, True),
        (2.0, 2.0, {}, False),
        (2.0, 1.0, {"jumping": (0,)}, False),
        (2.0, 1.0, {"curved": (0,)}, False),
        (2.0, 1.0, {"excites_others": True}, False),
        (0.001, 1.0, {}, False),
    ],
    ids=["there", "elsewhere", "jumps", "curved", "excites others", "beyond scatter"],
)
def test_scatter_at_the_simulated_size_is_no_effect(scatter_sd, at_ratio, also, is_scatter):
    plain = PRIORS._replace(scatter=np.diag([scatter_sd**2, 1e-6, 1e-6]))
    at, there = at_ratio * SIZES[:1], data()
    there = there._replace(none_square=there.none_square + 1000.0)
    twin = there._replace(square=there.none_square)
    none = CandidateSet((), SIZES[:0], SIZES[:0], {}, [twin], plain, plain, screen(twin, plain))
    priors = with_model_error(plain, there, (0,), at)
    one = CandidateSet((0,), at, at, {}, [there], priors, plain, screen(there, priors), **also)
    expected = none.base.log_evidence + 500.0 * is_scatter
    assert compared(none, one)[()] == pytest.approx(expected)


def test_lookalikes_of_leading_sets_are_evaluated():
    groups = [("valve_lag", "boom"), ("imu_latency", None), ("valve_dead_time", "boom")]
    problem = SimpleNamespace(layout=SimpleNamespace(groups=groups))
    both, swapped = candidate((0, 1), SIZES), candidate((1, 2), SIZES)
    points = missing_lookalikes(problem, [candidate(), both], [candidate(), both])
    assert list(points) == [(1, 2)]
    np.testing.assert_array_equal(points[1, 2], sizes_in(both, (1, 2)))
    assert missing_lookalikes(problem, [candidate(), both, swapped], [both]) == {}
    assert (
        missing_lookalikes(problem, [both], [candidate((0, 2), SIZES), candidate((1,), SIZES[:1])])
        == {}
    )


def test_effects_that_are_too_small_are_left_out():
    plan = layout(load_noise())
    problem = SimpleNamespace(layout=plan, profile=nominal_profile(load_spec()))
    late = plan.groups.index(("joint_sensor_latency", "slew"))
    band = plan.groups.index(("valve_dead_band", "dipper"))
    members = tuple(sorted((late, band)))

    def one(latency_s, band_ratio):
        sizes = {late: [latency_s], band: [band_ratio, 0.0]}
        at = np.concatenate([sizes[m] for m in members])
        return CandidateSet(members, at, at, {}, [], plan.priors, plan.priors, None)

    none = CandidateSet((), np.zeros(0), np.zeros(0), {}, [], plan.priors, plan.priors, None)
    large, small = one(0.02, 0.1), one(0.003, 0.1)
    impossible = one(-0.05, 0.1)
    assert large_enough(problem, [none, large, small, impossible]) == [none, large]


def test_missing_subsets_start_at_their_sizes_in_the_set():
    both, one = candidate((0, 1), SIZES), candidate((0,), SIZES[:1])
    points = missing_subsets([candidate(), one, both], [both])
    assert list(points) == [(1,)]
    np.testing.assert_array_equal(points[1,], SIZES[1:])


def test_missing_subsets_of_the_final_leader_are_evaluated(monkeypatch):
    monkeypatch.setattr(
        exploration, "evaluate", lambda _, points: [candidate(m, z) for m, z in points.items()]
    )
    for name in ("refine_until_close", "relinearise_if_better"):
        monkeypatch.setattr(exploration, name, lambda _, tried: tried)
    found = exploration.subsets_of_leader(
        None, [candidate(), candidate((0,), SIZES[:1]), candidate((0, 1), SIZES)]
    )
    assert [t.members for t in found] == [(1,)]
    np.testing.assert_array_equal(found[0].at, SIZES[1:])


def test_the_joint_of_a_clear_second_effect_is_examined():
    groups = [("imu_latency", None), ("valve_gain", "slew"), ("base_height", None)]
    problem = SimpleNamespace(layout=SimpleNamespace(groups=groups, is_unmodelled=lambda _: False))
    assert clear_partner_joints(problem, candidate((0,), SIZES[:1])) == ["slew"]
    assert clear_partner_joints(problem, candidate((0, 1), SIZES)) == []


def test_candidates_that_beat_no_effect_come_first(monkeypatch):
    far, behind, leader = (
        candidate((1,), SIZES[1:]),
        candidate((2,), SIZES[1:]),
        candidate((0,), SIZES[:1]),
    )
    monkeypatch.setattr(generation, "comparable_on_all", lambda _: [-20.0, -3.0, 50.0])
    monkeypatch.setattr(generation, "beats_none", lambda one: one is not behind)
    assert most_promising([far, behind, leader]) == [leader, far, behind]


@pytest.mark.parametrize(("start", "end", "simulations"), [(0.050, 0.035, 3), (0.030, 0.030, 1)])
def test_the_sizes_of_jumping_effects_are_iterated(monkeypatch, start, end, simulations):
    asked = []

    def at(size):
        return CandidateSet(
            (1,), np.array([size]), np.array([size - 0.005]), {}, [], PRIORS, PRIORS, None, (1,)
        )

    def evaluate(problem, points):
        asked.append(points)
        return [at(float(size[0])) for size in points.values()]

    monkeypatch.setattr(refinement, "evaluate", evaluate)
    monkeypatch.setattr(
        refinement, "evidence_at_simulated", lambda one: -abs(float(one.at[0]) - 0.030)
    )
    monkeypatch.setattr(comparison, "log_odds_over_none", lambda _: 100.0)
    (found,) = refinement.refine_until_close(SimpleNamespace(), [at(start)])
    assert float(found.at[0]) == pytest.approx(end)
    assert len(asked) == simulations


def test_a_jumping_effect_has_to_beat_no_effect_in_its_linearisation(monkeypatch):
    half, whole = candidate((1,), SIZES[1:], jumping=(1,)), candidate((1,), SIZES[1:], jumping=(1,))
    monkeypatch.setattr(
        comparison, "log_odds_over_none", lambda one: 100.0 if one is whole else 1.0
    )
    assert better(half, whole, lambda one: 20.0 * (one is half)) is whole
    assert better(whole, half, lambda one: 20.0 * (one is half)) is whole
    straight, other = candidate((1,), SIZES[1:]), candidate((1,), SIZES[1:])
    assert better(straight, other, lambda one: float(one is straight)) is straight
    assert better(straight, other, lambda one: float(one is other)) is other


def test_the_best_and_its_rivals_are_relinearised_twice(monkeypatch):
    previews = []

    def moved(_, tried, sizes):
        previews.append([(t.members, size.tolist()) for t, size in zip(tried, sizes, strict=True)])
        return list(tried)

    monkeypatch.setattr(refinement, "_relinearise", moved)
    behind = {(): 30.0, (0,): 0.0, (1,): 50.0, (2,): 400.0}
    monkeypatch.setattr(
        refinement, "comparable_on_all", lambda ts: [-behind[t.members] for t in ts]
    )
    tried = [
        candidate(),
        *(replace(candidate((m,), SIZES[:1]), sizes=np.array([5.0])) for m in range(3)),
    ]
    assert refinement.relinearise_near_best(None, tried) == tried
    first, second = previews
    assert [m for m, _ in first] == [(), (0,), (1,)]
    assert second == [((), []), ((0,), [5.0])], "at the sizes estimated meanwhile"


@pytest.mark.parametrize("ahead", [-50.0, 50.0])
def test_no_effect_has_the_less_favourable_residual(ahead):
    none = candidate()
    away = [i._replace(none_square=i.square - 2.0 * ahead) for i in none.information]
    found = refinement.with_consistent_residual(replace(none, information=away))
    with_it, without = comparison.screens(found, found.information[0])
    assert without.log_evidence - with_it.log_evidence == pytest.approx(min(ahead, 0.0), abs=1e-6)


def test_parameters_without_information_have_no_model_error():
    informed = data()
    precision = informed.precision.copy()
    precision[2], precision[:, 2] = 1e-9, 1e-9
    precision[2, 2] = -3e-11
    priors = with_model_error(PRIORS, informed._replace(precision=precision), (0,), np.array([3.0]))
    assert priors.scatter[2, 2] == PRIORS.scatter[2, 2]
    screen(informed._replace(precision=precision), priors)


def test_a_preview_uses_every_other_throw(monkeypatch):
    fields = ("prepared", "profile", "calibration", "healthy", "linear", "layout")
    whole, glance = (SimpleNamespace(worker=None, **dict.fromkeys(fields, n)) for n in (12, 6))
    whole.preview_subset = lambda: glance
    evaluated = []

    def relinearised(prepared, *_, **__):
        evaluated.append(prepared)
        return []

    monkeypatch.setattr(candidates, "relinearise", relinearised)
    candidates.evaluate(whole, [], is_preview=True)
    candidates.evaluate(whole, [])
    assert evaluated == [6, 12]


def test_a_worker_process_evaluates_half_where_there_is_more_than_one_set():
    asked = []
    worker = SimpleNamespace(split=lambda work, problem, items, *how: asked.append((items, how)))
    points = [((0,), np.array([1.0])), ((1,), np.array([2.0]))]
    candidates.evaluate(SimpleNamespace(worker=worker), points, is_preview=True)
    assert asked == [([(points[0], ()), (points[1], ())], (True, False))]
