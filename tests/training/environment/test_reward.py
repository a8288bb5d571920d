"""Rewards, by numbers worked out by hand, and by what must pay more than what."""

from dataclasses import replace

import numpy as np
import pytest

from tests.cases import each
from training.environment.reward import (
    RewardInputs,
    hurry_share,
    impact_reward,
    pace_loss,
    paper_reward,
    step_reward,
)
from training.environment.task import RewardConfig

IMPACT = RewardConfig()
COUNT = 24
"""Steps judged at once."""
PAPER = RewardConfig(kind="paper", action_ratio=0.0005, action_difference_ratio=0.01)


def _inputs(**changed: object) -> RewardInputs:
    """COUNT steps in which nothing happens, far from the target, but for what is changed."""
    zeros = np.zeros(COUNT)
    still = RewardInputs(
        action=np.zeros((COUNT, 4)),
        previous_action=np.zeros((COUNT, 4)),
        opened=zeros,
        progress_m=zeros,
        error_m=np.full((COUNT, 2), 100.0),
        best_error_m=np.full((COUNT, 2), 100.0),
        landed=np.zeros(COUNT, bool),
        landing_error_m=np.full(COUNT, 100.0),
        failed=np.zeros(COUNT, bool),
        pace_ratio=zeros,
        holds=np.zeros(COUNT, bool),
        left_m_per_s=zeros,
        hurry_ratio=np.asarray(1.0),
    )
    shape = {name: np.shape(value) for name, value in still._asdict().items()}
    # One shape for all tests: JAX compiles an operation once for each.
    return still._replace(
        **{k: np.broadcast_to(np.asarray(v), shape[k]) for k, v in changed.items()}
    )


@each("config", [IMPACT, PAPER])
def test_a_still_step_far_away_is_worth_nothing(config: RewardConfig):
    assert float(step_reward(config, _inputs())[0]) == pytest.approx(0.0, abs=1e-7)


@each(("changed", "worth"), [
        # progress of 0.3 m at 1 a metre, and the same backwards
        ({"progress_m": [0.3]}, 0.3),
        ({"progress_m": [-0.3]}, -0.3),
        # a jump of the hypothetical impact counts 5 m at most
        ({"progress_m": [40.0]}, 5.0),
        # 0.02 (0.5^2 + 1^2) for the change and 0.002 0.5^2 for the velocity; the release costs no effort
        ({"action": [[0.5, 0.0, 0.0, 1.0]]}, -0.02 * 1.25 - 0.002 * 0.25),
        # held actions cost their size alone
        ({"action": [[0.5, 0, 0, 1]], "previous_action": [[0.5, 0, 0, 1]]}, -0.002 * 0.25),
        # 2 + 4 + 4 at the target
        ({"landed": [True], "landing_error_m": [0.0]}, 10.0),
        # 2 exp(-0.0625) + 4 exp(-1) + 4 exp(-9.765625) - 0.5 0.25
        ({"landed": [True], "landing_error_m": [0.25]}, 1.87882613 + 1.47151776 + 0.00022957 - 0.125),
        # 7 m wide: no bell reaches, the loss is that of 4 m
        ({"landed": [True], "landing_error_m": [7.0]}, -2.0),
        ({"failed": [True]}, -5.0),
    ])  # fmt: skip
def test_impact_reward_by_hand(changed: dict[str, object], worth: float):
    assert float(impact_reward(IMPACT, _inputs(**changed))[0]) == pytest.approx(worth, abs=1e-6)


@each(("changed", "worth"), [
        # both distances shrink: 0.2 + 0.1
        ({"error_m": [[99.8, 99.9]]}, 0.3),
        # c1 counts the best so far, not the step before: going away costs nothing
        ({"error_m": [[101.0, 102.0]]}, 0.0),
        ({"error_m": [[99.8, 101.0]]}, 0.2),
        # 0.02 exp(-0.5 2^2) for being 2 m from the target, which it was already
        ({"error_m": [[1.0, 2.0]], "best_error_m": [[1.0, 2.0]]}, 0.02 * 0.13533528),
        # c3 0.01 |a - a'|^2 alone before the release, c4 0.0005 |a|^2 as well after it
        ({"action": [[1.0, 0.0, 0.0, 1.0]]}, -0.02),
        ({"action": [[1.0, 0.0, 0.0, 1.0]], "opened": [1.0]}, -0.02 - 0.001),
        ({"landed": [True], "landing_error_m": [0.0]}, 5.0),
        # 5 exp(-4 0.5^2)
        ({"landed": [True], "landing_error_m": [0.5]}, 5.0 * 0.36787944),
        ({"failed": [True]}, -5.0),
    ])  # fmt: skip
def test_paper_reward_by_hand(changed: dict[str, object], worth: float):
    assert float(paper_reward(PAPER, _inputs(**changed))[0]) == pytest.approx(worth, abs=1e-5)


@each("config", [IMPACT, PAPER])
def test_a_nearer_landing_always_pays_more(config: RewardConfig):
    error = np.linspace(0.0, 1.4, COUNT)
    pays = step_reward(config, _inputs(landed=True, landing_error_m=error))
    assert (np.diff(pays) < 0.0).all()
    # Where the bells are flat ours still has a slope to follow.
    if config.kind == "impact":
        far = np.linspace(3.0, 4.0, COUNT)
        slope = np.diff(step_reward(config, _inputs(landed=True, landing_error_m=far)))
        assert (slope < 0.0).all()


@each("config", [IMPACT, PAPER])
def test_larger_and_more_sudden_actions_pay_less(config: RewardConfig):
    action = np.zeros((COUNT, 4))
    action[:, 0] = np.linspace(0.0, 1.0, COUNT)
    assert (np.diff(step_reward(config, _inputs(action=action, opened=1.0))) < 0.0).all()
    held = _inputs(action=action, previous_action=action, opened=1.0)
    assert (np.diff(step_reward(config, held)) < 0.0).all()


@each("config", [IMPACT, PAPER])
def test_no_landing_is_so_bad_that_failing_would_pay(config: RewardConfig):
    landing = step_reward(config, _inputs(landed=[True], landing_error_m=[30.0]))
    failing = step_reward(config, _inputs(failed=[True]))
    assert float(failing[0]) < float(landing[0]) - 2.0


@each(("changed", "loss"), [
        # fast: 3.5 a second, 80 ms a step; nothing for the action
        ({"pace_ratio": 1.0, "action": [[0.5, 0.0, 0.0, 1.0]]}, 0.28),
        # half the pace, a quarter of the loss; half of the way into it
        ({"pace_ratio": 0.5, "hurry_ratio": 0.5}, 0.5 * 0.25 * 0.28),
        # careful: 0.02 a squared action, the release is free; 0.03 a squared m/s of the load that leaves
        ({"action": [[0.5, 0.0, 0.0, 1.0]]}, 0.02 * 0.25),
        ({"left_m_per_s": 4.0}, 0.03 * 16.0),
        ({"pace_ratio": 0.5, "left_m_per_s": 4.0}, 0.5 * 0.03 * 16.0 + 0.25 * 0.28),
        # the load is gone
        ({"pace_ratio": 1.0, "holds": False}, 0.0),
    ])  # fmt: skip
def test_loss_of_a_pace_by_hand(changed: dict[str, object], loss: float):
    inputs = _inputs(**{"holds": True, **changed})
    assert float(pace_loss(IMPACT, inputs)[0]) == pytest.approx(loss, abs=1e-6)
    without = float(step_reward(IMPACT, inputs)[0])
    paced = float(step_reward(IMPACT, inputs, is_paced=True)[0])
    assert paced == pytest.approx(without - loss, abs=1e-6)


def test_time_costs_nothing_until_throwing_is_learned():
    share = hurry_share(IMPACT, np.array([0.0, 0.35, 0.5, 0.65, 1.0]))
    np.testing.assert_allclose(share, [0.0, 0.0, 0.5, 1.0, 1.0], atol=1e-6)


def test_the_kind_chooses_the_terms():
    inputs = _inputs(progress_m=[1.0], error_m=[[98.0, 98.0]])
    assert float(step_reward(IMPACT, inputs)[0]) == pytest.approx(1.0)
    assert float(step_reward(replace(IMPACT, kind="paper"), inputs)[0]) == pytest.approx(4.0)
