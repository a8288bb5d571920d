"""Healthy throws of a machine give its own deviations; throws of another machine are refused."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from diagnosis import diagnose
from diagnosis.diagnose import CancelledError, diagnose_throws
from diagnosis.healthy.sensor_noise import with_measured_sensor_noise
from diagnosis.linearisation.open_loop import impacts
from diagnosis.linearisation.parameters import library
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.population.hierarchical_prior import Levels, SetLikelihood, learn, of_machine
from diagnosis.reference_throws import (
    check_reference,
    health_from_reference,
    reference_evidence,
)
from diagnosis.stages import swap_stages
from machine.errors import UsageError
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws

MACHINE_SD = np.array([3.0, 0.5])
SET_SD = np.array([0.5, 1.0])


def _sets(
    rng: np.random.Generator, machines: int, sets: int
) -> tuple[list[list[SetLikelihood]], np.ndarray]:
    """Machines whose sets see their parameters with unit noise, and what each machine is off."""
    off = np.array([1.0, 0.0]) + MACHINE_SD * rng.standard_normal((machines, 2))
    measured = off[:, None] + np.hypot(SET_SD, 1.0) * rng.standard_normal((machines, sets, 2))
    return [[SetLikelihood(np.eye(2), b) for b in one] for one in measured], off


def test_both_levels_are_learned() -> None:
    sets, _ = _sets(np.random.default_rng(0), 200, 4)
    first = Levels(np.zeros(2), np.eye(2), np.eye(2))
    levels = learn(sets, first, has_mean=np.array([True, False]), rounds=60)
    np.testing.assert_allclose(levels.mean, [1.0, 0.0], atol=0.4)
    assert levels.mean[1] == 0.0
    np.testing.assert_allclose(np.sqrt(np.diag(levels.machine)), MACHINE_SD, rtol=0.25)
    np.testing.assert_allclose(np.sqrt(np.diag(levels.within)), SET_SD, rtol=0.25)


def test_the_posterior_of_a_machine_covers_its_deviation() -> None:
    levels = Levels(np.array([1.0, 0.0]), np.diag(MACHINE_SD**2), np.diag(SET_SD**2))
    sets, off = _sets(np.random.default_rng(1), 300, 3)
    found = [of_machine(one, levels) for one in sets]
    miss = np.array([(m - (t - levels.mean)) for (m, _), t in zip(found, off, strict=True)])
    sd = np.sqrt(np.diag(found[0][1]))
    assert (sd < 0.6 * MACHINE_SD + 0.4).all()
    np.testing.assert_allclose(np.std(miss / sd, axis=0), 1.0, atol=0.15)


def test_the_twin_takes_a_machine_s_own_deviations_from_its_healthy_throws() -> None:
    longer = Effect(effect="gripper_length", parameters={"extra_length_m": 0.06})
    known, loaded = health(), throws((longer,), 6, seed=5)
    own = health_from_reference(loaded, profile(), known)
    assert own.is_own and own.profile is not None
    prepared = prepare(loaded.throws, profile())
    measured = np.stack([p.throw.impact_m[:2] for p in prepared])
    calibration = loaded.throws[0].calibration
    before, after = (
        np.linalg.norm(measured - impacts(prepared, own.filters, one, calibration), axis=1)
        for one in (profile(), own.profile)
    )
    assert after.mean() < 0.5 * before.mean()
    assert own.noise.healthy_gap_m["3d"] == pytest.approx(np.sqrt(np.mean(after**2)), rel=0.05)
    # What the answer calls the miss of the replay is the same for reference throws and diagnosed ones.
    gap_m = swap_stages(prepared, profile(), calibration).gap_m
    assert own.replay_gap_m == pytest.approx({"3d": float(np.sqrt((gap_m**2).sum(axis=1).mean()))})
    # From day to day nothing is steadier than the effect table's tolerance.
    of_sets = own.noise.set_scatter
    assert all(of_sets.sd_of(p.key) >= 0.999 * p.tolerance for p in library())


def renamed(loaded: LoadedSet) -> LoadedSet:
    return replace(
        loaded, throws=tuple(replace(t, throw_id=f"healthy-{t.throw_id}") for t in loaded.throws)
    )


def test_a_diagnosis_says_what_it_was_compared_with() -> None:
    cut = ((Path("cut.mcap"), "it ends too soon"),)
    assert reference_evidence(replace(renamed(throws((), 3, seed=5)), refused=cut)) == {
        "throws_count": 3,
        "throw_ids": [f"healthy-twin-{i:04d}" for i in range(3)],
        "refused": [{"path": "cut.mcap", "reason": "it ends too soon"}],
        "kept_utc": None,
    }
    assert reference_evidence(None) is None


def test_reference_throws_keep_the_type_s_sensor_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known, spy = health(), Mock(side_effect=CancelledError("seen"))
    monkeypatch.setattr(diagnose, "kept_or_estimated", spy)
    loaded, rng = throws(count=3), np.random.default_rng(1)
    noisy = tuple(
        replace(t, sensor_velocity_rad_m_per_s=t.sensor_velocity_rad_m_per_s + 0.02 * more)
        for t in loaded.throws
        for more in [rng.standard_normal(t.sensor_velocity_rad_m_per_s.shape)]
    )
    with pytest.raises(CancelledError):
        diagnose_throws(
            replace(loaded, throws=noisy), profile(), health=known, reference=renamed(loaded)
        )
    assert spy.call_args.args[2].noise == known.noise
    assert with_measured_sensor_noise(known.noise, replace(loaded, throws=noisy)) != known.noise


def test_reference_throws_are_refused_with_the_reason() -> None:
    loaded = throws(count=3)
    with pytest.raises(UsageError, match="3 throws are to be diagnosed and are reference throws"):
        diagnose_throws(loaded, profile(), health=health(), reference=loaded)
    few = replace(loaded, throws=loaded.throws[:2])
    with pytest.raises(UsageError, match="2 usable reference throws, at least 3"):
        check_reference(few, loaded.throws)
    others = replace(loaded, throws=tuple(replace(t, machine_id="m009") for t in loaded.throws))
    with pytest.raises(UsageError, match=r"'m009'.*'twin'"):
        check_reference(others, loaded.throws)
