"""How sets of effects, and parts of them, are compared."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.causes import candidates, hypotheses, settling, suspects, trials, weighing
from diagnosis.causes.candidates import (
    missing_parts,
    missing_twins,
    most_hopeful,
    plain_partner_joints,
)
from diagnosis.causes.evidence import Priors, inform, screen
from diagnosis.causes.least_sizes import of_some_size
from diagnosis.causes.parameters import layout
from diagnosis.causes.trials import sizes_in
from diagnosis.causes.weighing import (
    PART_LOG_ODDS,
    Trial,
    better,
    evidence_in,
    fair_evidence,
    formed,
    own_evidence,
    promised,
    told,
)
from diagnosis.healthy.noise import load_noise
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


def trial(members=(), sizes=None, bent=()):
    sizes = np.zeros(0) if sizes is None else sizes
    informed = data()
    priors = formed(PRIORS, informed, members, sizes) if members else PRIORS
    base = screen(informed, priors)
    return Trial(members, sizes, sizes, {}, [informed], priors, PRIORS, base, bent)


def compared(*trials):
    seen = [(i, t.members) for i, t in enumerate(trials)]
    found = fair_evidence(trials, seen, [t.information[0] for t in trials])
    return dict(zip((t.members for t in trials), found, strict=True))


def test_a_part_has_the_form_error_of_its_own_effects_only():
    """Or the effect that it lacks passes for an error of those that it has."""
    both, one = trial((0, 1), SIZES), trial((0,), SIZES[:1])
    found = compared(trial(), both, one)
    assert found[0, 1] - found[0,] > 40.0
    borrowed = evidence_in(both.base, PRIORS, (0,))
    assert found[0, 1] - borrowed < 30.0, "with the form error of both"


def test_sizes_that_nobody_simulated_are_a_promise():
    """A load simulated lighter by 0.5 kg promised that 0.1 kg explained what drag did."""
    near = trial((0,), SIZES[:1])
    far = replace(near, at=np.array([1.0]))
    assert promised(trial()) == promised(near) == 0.0
    assert own_evidence(far) == own_evidence(near)
    assert told(far) < told(near) - 100.0
    beyond = replace(near, sizes=np.array([12.0]), at=np.array([10.0]))
    assert promised(beyond) == 0.0, "it was simulated as far as the bound lets it"
    assert promised(replace(far, bent=(0,))) == 0.0


def test_in_the_end_no_set_counts_for_a_promise():
    near = trial((0,), SIZES[:1])
    trials = trial(), replace(near, at=np.array([1.0]))
    seen = [(0, ()), (1, (0,))]
    data = [t.information[0] for t in trials]
    found = fair_evidence(trials, seen, data)
    last = fair_evidence(trials, seen, data, is_last=True)
    assert found[1] - last[1] == pytest.approx(promised(trials[1]))
    assert found[0] == last[0]


def test_the_form_error_of_every_stage_is_its_own():
    groups, priors = layout(load_noise()).groups, layout(load_noise()).priors
    aim = groups.index(("base_yaw_drift", None))
    place = int(priors.groups[aim][0])
    precision = np.eye(priors.slab_sd.size)
    other = int(priors.groups[groups.index(("payload_mass", None))][0])
    precision[place, other] = precision[other, place] = 1.0
    informed = data()._replace(precision=precision)
    alone = formed(priors, informed, (aim,), np.array([1.0])).scatter
    dead = groups.index(("valve_dead_time", "boom"))
    with_drive = formed(priors, informed, (dead, aim), np.array([1.0, 1.0])).scatter
    assert alone[other, other] > priors.scatter[other, other]
    assert with_drive[other, other] == pytest.approx(alone[other, other])


@pytest.mark.parametrize(
    ("own", "other", "ratio"),
    [
        ("valve_lag", "valve_gain", 0.1),
        ("valve_gain", "valve_lag", 0.1),
        ("valve_lag", "valve_dead_time", 0.2),
        ("valve_lag", "unheard:way", 0.2),
        ("valve_gain", "unheard:way", 0.2),
        ("joint_sensor_latency", "valve_dead_time", 0.05),
    ],
)
def test_what_a_form_error_may_look_like(own, other, ratio):
    """Shapes are made of it, dead times and lags differ by little else; other names take half of it."""
    groups, priors = layout(load_noise()).groups, layout(load_noise()).priors
    first, second = (int(priors.groups[groups.index((e, "boom"))][0]) for e in (own, other))
    precision = np.eye(priors.slab_sd.size)
    precision[first, second] = precision[second, first] = 1.0
    members = (groups.index((own, "boom")),)
    sizes = np.zeros(priors.groups[members[0]].size)
    sizes[0] = 0.1
    found = formed(priors, data()._replace(precision=precision), members, sizes)
    extra = np.sqrt(np.diag(found.scatter - priors.scatter))
    assert extra[first] == 0.0
    assert extra[second] == pytest.approx(ratio * 0.1)


def test_what_slopes_cannot_take_back_is_given_to_no_part():
    both, one = trial((0, 1), SIZES), trial((0,), 0.5 * SIZES[:1])
    smooth = compared(trial(), both, one)
    bent = compared(trial(), trial((0, 1), SIZES, bent=(1,)), one)
    assert bent[0,] == pytest.approx(evidence_in(one.base, one.priors, (0,)))
    assert smooth[0, 1] == pytest.approx(bent[0, 1])
    curved = compared(trial(), replace(trial((0, 1), SIZES), curved=(1,)), one)
    assert curved == bent, "lift grows along a curve"
    kept = compared(trial(), replace(trial((0, 1), SIZES), curved=(0,)), one)
    assert kept == smooth, "a part that has it"


def test_a_part_gains_little_by_the_slopes_about_the_whole_set():
    """They carry nothing back where a joint stands: a dead time had the dead band beside it for nothing."""
    both, one = trial((0, 1), SIZES), trial((0,), SIZES[:1])
    lost = one.information[0]._replace(log_volume=one.information[0].log_volume + 500.0)
    poor = replace(one, information=[lost])
    own = evidence_in(screen(lost, one.priors), one.priors, (0,))
    assert compared(trial(), both, poor)[0,] == pytest.approx(own + PART_LOG_ODDS)
    shaken = compared(trial(), replace(both, is_shaken=True), poor)
    assert shaken[0,] == compared(trial(), replace(both, is_shaken=True), one)[0,] > own + 400.0


@pytest.mark.parametrize(
    ("scatter_sd", "at_ratio", "also", "is_scatter"),
    [
        (2.0, 1.0, {}, True),
        (2.0, 2.0, {}, False),
        (2.0, 1.0, {"bent": (0,)}, False),
        (2.0, 1.0, {"curved": (0,)}, False),
        (2.0, 1.0, {"is_shaken": True}, False),
        (0.001, 1.0, {}, False),
    ],
    ids=["there", "elsewhere", "bent", "curved", "shakes others", "no machine is off by as much"],
)
def test_a_machine_that_is_there_by_itself_is_no_effect(scatter_sd, at_ratio, also, is_scatter):
    """What is told better because it was simulated is told so for a healthy machine that is there, too."""
    plain = PRIORS._replace(scatter=np.diag([scatter_sd**2, 1e-6, 1e-6]))
    at, there = at_ratio * SIZES[:1], data()
    there = there._replace(bare_square=there.bare_square + 1000.0)
    twin = there._replace(square=there.bare_square)
    none = Trial((), SIZES[:0], SIZES[:0], {}, [twin], plain, plain, screen(twin, plain))
    priors = formed(plain, there, (0,), at)
    one = Trial((0,), at, at, {}, [there], priors, plain, screen(there, priors), **also)
    told_by = none.base.log_evidence + 500.0 * is_scatter
    assert compared(none, one)[()] == pytest.approx(told_by)


def test_a_lag_is_not_named_before_a_dead_time_was_simulated():
    """At the same joint, at the size that slopes give it there, beside the same other effects."""
    groups = [("valve_lag", "boom"), ("imu_latency", None), ("valve_dead_time", "boom")]
    problem = SimpleNamespace(layout=SimpleNamespace(groups=groups))
    both, swapped = trial((0, 1), SIZES), trial((1, 2), SIZES)
    seeds = missing_twins(problem, [trial(), both], [trial(), both])
    assert list(seeds) == [(1, 2)]
    np.testing.assert_array_equal(seeds[1, 2], sizes_in(both, (1, 2)))
    assert missing_twins(problem, [trial(), both, swapped], [both]) == {}
    assert missing_twins(problem, [both], [trial((0, 2), SIZES), trial((1,), SIZES[:1])]) == {}


def test_effects_too_small_to_be_any_are_left_out():
    plan = layout(load_noise())
    problem = SimpleNamespace(layout=plan, profile=nominal_profile(load_spec()))
    late = plan.groups.index(("joint_sensor_latency", "slew"))
    band = plan.groups.index(("valve_dead_band", "dipper"))
    members = tuple(sorted((late, band)))

    def one(latency_s, band_ratio):
        sizes = {late: [latency_s], band: [band_ratio, 0.0]}
        at = np.concatenate([sizes[m] for m in members])
        return Trial(members, at, at, {}, [], plan.priors, plan.priors, None)

    none = Trial((), np.zeros(0), np.zeros(0), {}, [], plan.priors, plan.priors, None)
    large, small = one(0.02, 0.1), one(0.003, 0.1)
    impossible = one(-0.05, 0.1)
    assert of_some_size(problem, [none, large, small, impossible]) == [none, large]


@pytest.mark.parametrize(
    ("effect", "share", "is_some"),
    [
        ("valve_lag", -0.15, False),
        ("valve_lag", -0.3, True),
        ("valve_lag", 0.15, True),
        ("valve_dead_time", -0.09, False),
        ("valve_dead_time", -0.15, True),
        ("valve_dead_time", 0.09, True),
        ("valve_gain", -0.15, True),
    ],
)
def test_a_joint_that_is_hardly_faster_than_its_response_is_left_out(effect, share, is_some):
    """Below a share of its mean lag a measured response may be off by as much; a slower joint counts."""
    plan, profile = layout(load_noise()), nominal_profile(load_spec())
    group = plan.groups.index((effect, "slew"))
    lag_s = 2.0 * profile.damping_ratio[0] / profile.natural_frequency_rad_per_s[0]
    size = np.full(plan.priors.groups[group].size, share * lag_s)
    one = Trial((group,), size, size, {}, [], plan.priors, plan.priors, None)
    problem = SimpleNamespace(layout=plan, profile=profile)
    assert (of_some_size(problem, [one]) == [one]) is is_some


@pytest.mark.parametrize(
    ("effect", "joint", "size", "beside", "is_some"),
    [
        ("speed_limit", "boom", 0.15, None, False),
        ("speed_limit", "slew", 0.15, None, True),
        ("speed_limit", "slew", 0.15, "valve_dead_time", False),
        ("speed_limit", "slew", 0.35, "valve_dead_time", True),
        ("stiction", "slew", 0.012, None, True),
        ("stiction", "slew", 0.04, "joint_sensor_latency", False),
        ("stiction", "slew", 0.05, "joint_sensor_latency", True),
        ("backlash", "boom", 0.002, "valve_hysteresis", False),
        ("backlash", "boom", 0.004, "valve_hysteresis", True),
    ],
)
def test_what_bends_within_scatter_or_little_beside_another_effect_is_left_out(
    effect, joint, size, beside, is_some
):
    """Healthy booms scatter by a limit of 0.16, and what a limit cuts off may be another effect's error."""
    plan = layout(load_noise())
    sizes = {plan.groups.index((effect, joint)): size}
    if beside is not None:
        sizes[plan.groups.index((beside, joint))] = 0.2
    members = tuple(sorted(sizes))
    at = np.array([sizes[m] for m in members])
    one = Trial(members, at, at, {}, [], plan.priors, plan.priors, None)
    problem = SimpleNamespace(layout=plan, profile=nominal_profile(load_spec()))
    assert (of_some_size(problem, [one]) == [one]) is is_some


def test_parts_of_the_leading_sets_begin_at_the_sizes_they_have_there():
    both, one = trial((0, 1), SIZES), trial((0,), SIZES[:1])
    seeds = missing_parts([trial(), one, both], [both])
    assert list(seeds) == [(1,)]
    np.testing.assert_array_equal(seeds[1,], SIZES[1:])


def test_parts_of_the_set_that_leads_in_the_end_are_simulated(monkeypatch):
    """Where its machine is a set may lead that did not lead before."""
    monkeypatch.setattr(
        hypotheses, "try_sets", lambda _, seeds: [trial(m, z) for m, z in seeds.items()]
    )
    for name in ("nearer", "moved_there"):
        monkeypatch.setattr(hypotheses, name, lambda _, tried: tried)
    found = hypotheses.parts_of_leader(
        None, [trial(), trial((0,), SIZES[:1]), trial((0, 1), SIZES)]
    )
    assert [t.members for t in found] == [(1,)]
    np.testing.assert_array_equal(found[0].at, SIZES[1:])


def test_a_second_effect_that_slopes_show_plainly_makes_its_joint_suspect():
    """What is there may be something at that joint that slopes do not show."""
    groups = [("imu_latency", None), ("valve_gain", "slew"), ("base_height", None)]
    problem = SimpleNamespace(layout=SimpleNamespace(groups=groups, is_unheard=lambda _: False))
    assert plain_partner_joints(problem, trial((0,), SIZES[:1])) == ["slew"]
    assert plain_partner_joints(problem, trial((0, 1), SIZES)) == []


def test_what_beats_no_effect_comes_before_what_does_not(monkeypatch):
    far, behind, leader = trial((1,), SIZES[1:]), trial((2,), SIZES[1:]), trial((0,), SIZES[:1])
    monkeypatch.setattr(candidates, "fair_on_all", lambda _: [-20.0, -3.0, 50.0])
    monkeypatch.setattr(candidates, "is_ahead", lambda one: one is not behind)
    assert most_hopeful([far, behind, leader]) == [leader, far, behind]


@pytest.mark.parametrize(("start", "end", "simulations"), [(0.050, 0.035, 3), (0.030, 0.030, 1)])
def test_a_bent_effect_is_followed_to_its_size(monkeypatch, start, end, simulations):
    """Its estimate says where to look next; the best of what was simulated stays."""
    asked = []

    def at(size):
        return Trial(
            (1,), np.array([size]), np.array([size - 0.005]), {}, [], PRIORS, PRIORS, None, (1,)
        )

    def try_sets(problem, seeds):
        asked.append(seeds)
        return [at(float(size[0])) for size in seeds.values()]

    monkeypatch.setattr(settling, "try_sets", try_sets)
    monkeypatch.setattr(settling, "told", lambda one: -abs(float(one.at[0]) - 0.030))
    monkeypatch.setattr(weighing, "lead", lambda _: 100.0)
    (found,) = settling.nearer(SimpleNamespace(), [at(start)])
    assert float(found.at[0]) == pytest.approx(end)
    assert len(asked) == simulations


def test_a_bent_effect_has_to_beat_no_effect_where_it_was_simulated(monkeypatch):
    """What slopes about half a limit explain without the limit is no evidence for half of it."""
    half, whole = trial((1,), SIZES[1:], bent=(1,)), trial((1,), SIZES[1:], bent=(1,))
    monkeypatch.setattr(weighing, "lead", lambda one: 100.0 if one is whole else 1.0)
    assert better(half, whole, lambda one: 20.0 * (one is half)) is whole
    assert better(whole, half, lambda one: 20.0 * (one is half)) is whole
    straight, other = trial((1,), SIZES[1:]), trial((1,), SIZES[1:])
    assert better(straight, other, lambda one: float(one is straight)) is straight
    assert better(straight, other, lambda one: float(one is other)) is other


def sizes_beside(effect, joint, second):
    """Sizes of an effect of 0.2 and 0.4 (0.2 alone), and of a second one, to start from together."""
    plan = layout(load_noise())
    one, other = plan.groups.index((effect, joint)), plan.groups.index(second)
    at = np.array([0.2, 0.4])[: plan.priors.groups[one].size]
    single = Trial((one,), at, at, {}, [], plan.priors, plan.priors, None)
    return candidates._sizes_together(SimpleNamespace(layout=plan), single, other)


def test_a_dead_band_may_be_smaller_beside_a_gain_or_stiction_of_its_joint():
    """Alone it also stands for what those do."""
    smaller = [[0.2, 0.24], [0.12, 0.4], [0.12, 0.24]]
    beside_gain = sizes_beside("valve_dead_band", "boom", ("valve_gain", "boom"))
    np.testing.assert_allclose([at for at, _ in beside_gain], smaller)
    assert not np.any([gain for _, gain in beside_gain]), "slopes tell it"
    beside_stiction = sizes_beside("valve_dead_band", "boom", ("stiction", "boom"))
    shares, speeds = {tuple(at) for at, _ in beside_stiction}, {s for _, (s,) in beside_stiction}
    assert len(shares) == 4
    assert (0.2, 0.4) in shares
    assert len(beside_stiction) == len(shares) * len(speeds)
    assert min(speeds) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("effect", "second", "count"),
    [
        ("valve_dead_band", ("valve_gain", "dipper"), 0),
        ("valve_dead_band", ("stiction", "dipper"), 2),
        ("valve_hysteresis", ("stiction", "boom"), 2),
        ("valve_hysteresis", ("valve_gain", "boom"), 0),
    ],
)
def test_others_stay_as_they_are_beside_a_second_effect(effect, second, count):
    found = sizes_beside(effect, "boom", second)
    assert len(found) == count
    assert all(at[0] == 0.2 for at, _ in found)


def test_the_best_and_its_rivals_are_looked_at_twice_no_effect_too(monkeypatch):
    """A second look that only effects have is worth something to them: healthy machines had alarms for it."""
    looks = []

    def moved(_, tried, sizes):
        looks.append([(t.members, size.tolist()) for t, size in zip(tried, sizes, strict=True)])
        return list(tried)

    monkeypatch.setattr(settling, "_moved_there", moved)
    behind = {(): 30.0, (0,): 0.0, (1,): 50.0, (2,): 400.0}
    monkeypatch.setattr(settling, "fair_on_all", lambda ts: [-behind[t.members] for t in ts])
    tried = [trial(), *(replace(trial((m,), SIZES[:1]), sizes=np.array([5.0])) for m in range(3))]
    assert settling.where_they_are(None, tried) == tried
    first, second = looks
    assert [m for m, _ in first] == [(), (0,), (1,)]
    assert second == [((), []), ((0,), [5.0])], "at the sizes estimated meanwhile"


def test_large_sizes_are_tried_one_way_at_a_time():
    """A dead band that is large both ways hides one that is large one way."""
    plan = layout(load_noise())
    group = plan.groups.index(("valve_dead_band", "dipper"))
    typical, positive, negative, between = suspects.sizes_beyond_slopes(
        SimpleNamespace(layout=plan), group
    )
    assert (typical > 0.0).all()
    assert (between > typical).all()
    assert (between < 3.0 * typical).all()
    np.testing.assert_allclose(positive, [3.0 * typical[0], 0.0])
    np.testing.assert_allclose(negative, [0.0, 3.0 * typical[1]])


@pytest.mark.parametrize("ahead", [-50.0, 50.0])
def test_no_effect_is_told_by_what_is_left_where_slopes_were_taken(ahead):
    """Never better than that: what is left at the twin goes with the slopes there."""
    none = trial()
    away = [i._replace(bare_square=i.square - 2.0 * ahead) for i in none.information]
    found = settling.at_home(replace(none, information=away))
    with_it, without = weighing.screens(found, found.information[0])
    assert without.log_evidence - with_it.log_evidence == pytest.approx(min(ahead, 0.0), abs=1e-6)


def test_what_the_data_say_nothing_about_looks_like_nothing():
    """Its products are rounding errors: a drift that no throw showed scattered by 5e5 and stopped a look."""
    informed = data()
    precision = informed.precision.copy()
    precision[2], precision[:, 2] = 1e-9, 1e-9
    precision[2, 2] = -3e-11
    priors = formed(PRIORS, informed._replace(precision=precision), (0,), np.array([3.0]))
    assert priors.scatter[2, 2] == PRIORS.scatter[2, 2]
    screen(informed._replace(precision=precision), priors)


def test_a_rough_look_is_at_every_other_throw(monkeypatch):
    fields = ("prepared", "profile", "calibration", "healthy", "linear", "layout")
    whole, glance = (SimpleNamespace(second=None, **dict.fromkeys(fields, n)) for n in (12, 6))
    whole.at_a_glance = lambda: glance
    seen = []

    def relinearised(prepared, *_, **__):
        seen.append(prepared)
        return []

    monkeypatch.setattr(trials, "relinearise", relinearised)
    trials.try_sets(whole, [], is_rough=True)
    trials.try_sets(whole, [])
    assert seen == [6, 12]


def test_a_second_process_tries_sets_where_there_is_more_than_one():
    asked = []
    second = SimpleNamespace(halved=lambda work, problem, items, *how: asked.append((items, how)))
    seeds = [((0,), np.array([1.0])), ((1,), np.array([2.0]))]
    trials.try_sets(SimpleNamespace(second=second), seeds, is_rough=True)
    assert asked == [([(seeds[0], ()), (seeds[1], ())], (True, False))]


@pytest.mark.parametrize(
    ("behind", "grown", "is_stale"),
    [
        (("gripper_length", None), ("joint_sensor_bias", "telescope"), True),
        (("joint_sensor_latency", "dipper"), ("joint_sensor_bias", "dipper"), False),
        (("gripper_length", None), ("valve_lag", "boom"), False),
    ],
)
def test_a_sensors_bias_has_the_slopes_of_no_effect_beside_what_swings(behind, grown, is_stale):
    plan = layout(load_noise())
    one, other = (plan.groups.index(named) for named in (behind, grown))
    found = candidates._has_stale_slopes(
        SimpleNamespace(layout=plan), SimpleNamespace(members=(one,)), other
    )
    assert found is is_stale
