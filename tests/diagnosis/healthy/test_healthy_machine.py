"""The model of healthy machines: filters, noise, jitter of the opening."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.healthy.filters import HealthyModel, correction, inputs, learn, nothing
from diagnosis.healthy.noise import ChannelNoise, Scatter, load_noise, part_of, whiten, whitener
from diagnosis.hypotheses.release_jitter import fit_jitter
from diagnosis.linearisation.nuisances import throw_nuisances
from diagnosis.linearisation.parameters import layout, library, scatter_names
from diagnosis.loading.prepared import prepare
from diagnosis.separating_motions import separating_motion
from machine.errors import UsageError
from sim_twin.effects.effect import Effect
from tests.cases import each
from tests.diagnosis.twin_throws import health, profile, throws


def test_filter_learns_what_is_linear_in_its_inputs() -> None:
    p = prepare(throws((), 2).throws, profile())[0]
    rng = np.random.default_rng(0)
    predicted = np.cumsum(0.01 * rng.standard_normal(p.motion.t_s.size))
    values = inputs(p.motion, 1, predicted)
    truth = 0.1 * predicted + 0.02 * p.motion.acceleration_rad_m_per_s2[:, 2]
    learned = learn([values], [truth])
    model = HealthyModel(note="", joints=(learned,) * 4)
    found = correction(model, p.motion, 1, predicted)
    assert np.std(found - truth) < 0.2 * np.std(truth)
    both = correction(model, p.motion, 1, np.stack([predicted, predicted]))
    np.testing.assert_allclose(both, [found, found])


def test_healthy_deviations_of_different_parts_are_independent() -> None:
    model = load_noise()
    names = scatter_names()
    for scatter in (model.machine_scatter, model.set_scatter):
        covariance = scatter.covariance(names)
        parts = np.array([part_of(name) for name in names])
        assert np.all(covariance[parts[:, None] != parts] == 0.0)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    lag, dead_time = "valve_lag.slew.extra_lag_s", "valve_dead_time.slew.extra_dead_time_s"
    assert part_of(lag) == part_of(dead_time) == "actuation.slew"
    one = model.machine_scatter.covariance((lag, dead_time))
    assert one[0, 1] < 0.0, "a longer dead time passes for a shorter lag"


def test_a_parameter_that_healthy_machines_were_measured_without_is_named() -> None:
    with pytest.raises(UsageError, match=r"valve_leak\.boom\.flow_ratio.*population\.estimation"):
        load_noise().machine_scatter.covariance((*scatter_names(), "valve_leak.boom.flow_ratio"))


def test_nothing_corrects_nothing() -> None:
    p = prepare(throws((), 2).throws, profile())[0]
    track = np.ones(p.motion.t_s.size)
    assert not correction(nothing(), p.motion, 0, track).any()


def test_whitened_discrepancy_has_unit_power() -> None:
    channel = ChannelNoise(noise_sd=0.1, floor_sd=0.3, rate_ratio=0.5, push_ratio=0.0, memory_s=0.1)
    t = np.arange(60, dtype=np.float64) * 0.02
    rate = np.abs(np.sin(t))
    factor = whitener(channel, t, rate, np.zeros(60))
    np.testing.assert_allclose(np.diag(factor @ factor.T), 0.01 + (0.3 + 0.5 * rate) ** 2)
    draws = factor @ np.random.default_rng(1).standard_normal((60, 4000))
    assert np.cov(whiten(factor, draws)) == pytest.approx(np.eye(60), abs=0.12)


def test_calibrated_files_fit_the_library() -> None:
    noise = load_noise()
    assert noise.machine_scatter.names == noise.set_scatter.names == scatter_names()
    assert noise.throw_scatter.names == throw_nuisances()
    plan = layout(noise)
    assert len(plan.groups) == len(plan.priors.groups) == plan.priors.log_prior.size
    assert np.linalg.eigvalsh(plan.priors.scatter).min() > 0.0
    assert np.linalg.eigvalsh(noise.throw_scatter.covariance(throw_nuisances())).min() > 0.0


def test_scatter_keeps_its_covariance_through_a_file() -> None:
    root = np.random.default_rng(0).standard_normal((4, 6))
    covariance = root @ root.T
    kept = Scatter.model_validate_json(Scatter.of("abcd", covariance).model_dump_json())
    np.testing.assert_allclose(kept.covariance("abcd"), covariance, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(kept.covariance("db"), covariance[np.ix_([3, 1], [3, 1])], rtol=2e-3)
    assert kept.with_sd("b", 2.0).covariance("b")[0, 0] == pytest.approx(4.0)


@each(("extra_s", "is_found"), [(0.0, False), (0.08, True)])
def test_jitter_is_a_spread_and_not_a_mean(extra_s: float, is_found: bool) -> None:
    rng = np.random.default_rng(3)
    loaded = throws((), 12)
    late = [
        replace(t, switch_open_t_s=t.switch_open_t_s + 0.1 + extra_s * rng.standard_normal())
        for t in loaded.throws
    ]
    found = fit_jitter(prepare(late, profile()), profile(), health().noise)
    assert (found.log_odds > 0.0) is is_found
    if is_found:
        assert found.ci90_s[0] < extra_s < found.ci90_s[1] + 0.02


@each(("follows_s", "jitter_s"), [(0.06, 0.0), (0.06, 0.02), (0.0, 0.06)])
def test_a_spread_that_follows_the_swing_is_no_jitter(follows_s: float, jitter_s: float) -> None:
    rng = np.random.default_rng(4)
    loaded = throws((), 12)
    rate = [
        np.interp(t.open_command_t_s, p.motion.t_s, p.motion.swing_rate_rad_per_s[:, 0])
        for t, p in zip(loaded.throws, prepare(loaded.throws, profile()), strict=True)
    ]
    late_s = follows_s * (rate - np.mean(rate)) / np.std(rate) + jitter_s * rng.standard_normal(12)
    late = [
        replace(t, switch_open_t_s=t.switch_open_t_s + 0.1 + own)
        for t, own in zip(loaded.throws, late_s, strict=True)
    ]
    found = fit_jitter(prepare(late, profile()), profile(), health().noise)
    assert found.log_odds > 0.0
    assert (found.follows_log_odds > 0.0) is (follows_s > 0.0)
    prepared = prepare(late, profile())
    none = np.zeros_like(prepared[0].motion.swing_rad)
    hanging = prepared[0].motion._replace(swing_rad=none, swing_rate_rad_per_s=none)
    still = [replace(p, motion=hanging) for p in prepared]
    assert fit_jitter(still, profile(), health().noise).follows_log_odds == -np.inf


def test_every_pair_of_effects_has_a_separating_motion() -> None:
    singles = {p.effect: p.at(p.step) for p in library()}
    for first in singles.values():
        for second in singles.values():
            motion = separating_motion(first, second)
            assert motion["kind"]
            assert motion["words"]
    lag = Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": 0.1})
    dead = Effect(effect="valve_dead_time", joint="boom", parameters={"extra_dead_time_s": 0.1})
    assert separating_motion(lag, dead)["joint"] == "boom"
