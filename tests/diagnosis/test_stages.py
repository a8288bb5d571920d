"""The stage swap: terms sum to the gap, and an effect's term is its own stage's."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.loading.prepared import prepare
from diagnosis.stages import Terms, release_state, stage_gaps, swap_stages
from diagnosis.verdict import Stage
from machine.ballistics import drag_per_m, step_flight
from machine.spec import load_spec
from sim_twin.effects.effect import Effect
from tests.cases import each
from tests.diagnosis.twin_throws import profile, throws

COUNT = 4


def swapped(*effects: Effect, tracked: bool = True) -> Terms:
    loaded = throws(effects, COUNT)
    chosen = loaded.throws
    if not tracked:
        chosen = tuple(replace(t, ball_t_s=t.ball_t_s[:0], ball_m=t.ball_m[:0]) for t in chosen)
    return swap_stages(prepare(chosen, profile()), profile(), loaded.throws[0].calibration)


@each("tracked", [True, False])
def test_terms_sum_to_the_gap_exactly(tracked: bool) -> None:
    effect = Effect(effect="valve_gain", joint="boom", parameters={"negative_ratio": 0.2})
    terms = swapped(effect, tracked=tracked)
    assert np.isfinite(terms.gap_m).all()
    np.testing.assert_allclose(terms.term_m.sum(axis=0), terms.gap_m, atol=1e-9)


@each(
    ("effect", "stage", "joint"),
    [
        (
            Effect(effect="valve_lag", joint="dipper", parameters={"extra_lag_s": 0.15}),
            Stage.ACTUATION,
            "dipper",
        ),
        (
            Effect(effect="gripper_inertia", parameters={"extra_inertia_ratio": 0.8}),
            Stage.SWING,
            None,
        ),
        (Effect(effect="release_delay", parameters={"extra_delay_s": 0.1}), Stage.RELEASE, None),
        (Effect(effect="sticky_release", parameters={"slowdown_ratio": 0.3}), Stage.RELEASE, None),
        (Effect(effect="wind", parameters={"x_m_per_s": 10.0}), Stage.FLIGHT, None),
        (Effect(effect="base_yaw_drift", parameters={"yaw_rad": 0.1}), Stage.AIM, None),
    ],
)
def test_largest_term_is_where_the_effect_is(
    effect: Effect, stage: Stage, joint: str | None
) -> None:
    gaps = stage_gaps(swapped(effect))
    largest = max(gaps, key=lambda gap: gap.share_ratio)
    assert (largest.stage, largest.joint) == (stage, joint)
    assert sum(gap.share_ratio for gap in gaps) == pytest.approx(1.0)
    assert largest.ci90_m[0] <= largest.miss_m.downrange <= largest.ci90_m[1]


def test_release_state_from_a_track_that_starts_late() -> None:
    k = drag_per_m(load_spec().ball)
    true = np.array([5.0, 0.2, 1.5, 3.0, 0.5, 4.0])
    position, velocity = true[:3], true[3:]
    times, points = [], []
    for tick in range(1, 70):
        position, velocity = step_flight(position, velocity, k, np.zeros(3), np.array(0.01))
        if tick >= 4 and tick % 2 == 0:
            times.append(tick * 0.01)
            points.append(position)
    rng = np.random.default_rng(0)
    track = np.array(points) + 0.005 * rng.standard_normal((len(points), 3))
    found = release_state(np.array(times), track)
    np.testing.assert_allclose(found[:3], true[:3], atol=0.01)
    np.testing.assert_allclose(found[3:], true[3:], atol=0.1)
