"""Baselines: the parts that compute, on problems with known answers."""

import numpy as np
import pytest

from challenge.baselines.baseline_case import Candidate, Case, conclude
from challenge.baselines.lag import lag_ticks
from challenge.baselines.tune_all import cma_es
from diagnosis.verdict import VerdictKind
from machine.calibration import nominal_calibration
from machine.conventions import Array
from machine.spec import load_spec
from sim_twin.twin.profile import nominal_profile


def test_lag_is_the_shift_between_signals() -> None:
    t = np.arange(300) * 0.01
    twin = np.sin(7.0 * t) * np.exp(-((t - 1.5) ** 2))
    assert lag_ticks(twin, np.roll(twin, 6)) == 6
    assert lag_ticks(twin, np.roll(twin, -4)) == -4
    assert lag_ticks(twin, 0.5 * twin) == 0


def test_cma_es_finds_the_bottom_of_a_tilted_valley() -> None:
    rng = np.random.default_rng(2)
    axes, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    goal = rng.standard_normal(6)
    scales = 10.0 ** np.linspace(0.0, 2.0, 6)

    def costs(points: Array) -> Array:
        return (((points - goal) @ axes * scales) ** 2).sum(axis=1)

    best, spread = cma_es(costs, np.zeros(6), 0.5, generations=250, population=12, rng=rng)
    assert best == pytest.approx(goal, abs=1e-3)
    assert spread.max() < 0.01


def test_the_largest_score_is_claimed_above_one_only() -> None:
    spec = load_spec()
    rows = np.arange(0)
    case = Case([], nominal_profile(spec), nominal_calibration(spec), rows, rows, np.zeros((0, 2)))
    strong = Candidate("valve_lag", "boom", {"extra_lag_s": (0.1, 0.01)}, 3.0)
    weak = Candidate("wind", None, {"x_m_per_s": (1.0, 1.0)}, 0.5)
    found = conclude(case, [weak, strong], ())
    assert found.verdict is VerdictKind.EXPLAINED
    assert found.causes[0].effects[0].effect == "valve_lag"
    assert found.evidence["where"] == {"stage": "actuation", "joint": "boom"}
    assert sum(cause.probability for cause in found.causes) == pytest.approx(1.0)
    quiet = conclude(case, [weak], ())
    assert quiet.verdict is VerdictKind.NONE
    assert quiet.causes[0].name == "none"
