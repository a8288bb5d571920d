"""Numbers and configurations that the paper states, one by one (docs/paper_items.md lists where)."""

import json
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import pytest

from machine.conventions import CONTROL_PERIOD_S, POLICY_PERIOD_S, RELEASE_THRESHOLD_RATIO, Mode
from machine.policy_card import load_card
from machine.spec import load_spec
from runtime.control.observation import ACTION_NAMES, OBSERVATION_NAMES
from runtime.control.policy import find_policy
from tests.cases import each
from training.environment.configurations import learner_for, task_for
from training.environment.task import PassiveConfig, PpoConfig, RewardConfig
from training.environment.throw_environment import ThrowEnvironment
from training.networks import make_networks

SPEC = load_spec()
POLICIES = Path(__file__).parents[2] / "policies"
YEAR_S = 365.25 * 24 * 3600.0


def as_json(config: Any) -> dict[str, Any]:
    """A configuration as a card holds it."""
    return json.loads(json.dumps(asdict(config)))


def test_simulator_at_100_hertz_control_at_12_and_a_half():
    assert pytest.approx(0.01) == CONTROL_PERIOD_S
    assert pytest.approx(0.08) == POLICY_PERIOD_S


@each("mode", list(Mode))
def test_training_with_the_papers_reward_has_the_papers_experience(mode: Mode):
    """8192 environments, 32 control steps, 4000 iterations: 2.66 years."""
    ppo = learner_for(mode, "paper")
    assert (ppo.environment_count, ppo.step_count, ppo.iteration_count) == (8192, 32, 4000)
    steps = ppo.environment_count * ppo.step_count * ppo.iteration_count
    assert steps * POLICY_PERIOD_S / YEAR_S == pytest.approx(2.66, abs=0.01)


@each("mode", list(Mode))
def test_the_active_policy_is_what_its_one_command_trains(mode: Mode):
    """Learner and task on the card are those of `downrange train --mode MODE` (docs/training.md)."""
    card = load_card(find_policy(POLICIES, mode))
    assert card.training is not None
    told = card.training.config
    # A setting that came after the training is at the value that leaves everything as it was.
    assert {**as_json(PpoConfig()), **told["ppo"]} == as_json(learner_for(mode))
    assert {**as_json(task_for(mode)), **told["task"]} == as_json(task_for(mode))


@each("mode", list(Mode))
def test_both_policies_are_perceptrons_of_256_and_128(mode: Mode):
    env = ThrowEnvironment(SPEC, task_for(mode, "paper"))
    made = make_networks(
        jax.random.key(0),
        env.observation_count,
        3,
        env.action_count,
        PpoConfig().hidden_count,
        0.0,
    )
    inputs, outputs = (65, 5) if mode is Mode.SPATIAL else (56, 4)
    assert [w.shape for w, _ in made.actor] == [(inputs, 256), (256, 128), (128, outputs)]


def test_the_observation_has_the_rows_of_the_papers_table():
    def row(name: str) -> str:
        if name.startswith("previous_"):
            return "previous commands"
        for start in ("grip_position", "grip_velocity", "target"):
            if name.startswith(start):
                return start
        for kind in ("_position_k", "_velocity_k"):
            if kind in name:
                return kind
        return name

    spatial = Counter(row(name) for name in OBSERVATION_NAMES[Mode.SPATIAL])
    assert spatial == {
        "_position_k": 24, "_velocity_k": 24, "previous commands": 5, "grip_position": 3,
        "grip_velocity": 3, "horizontal_error": 1, "error": 1, "target": 3, "opened": 1,
    }  # fmt: skip
    dropped = set(OBSERVATION_NAMES[Mode.SPATIAL]) - set(OBSERVATION_NAMES[Mode.PLANAR])
    assert len(dropped) == 9
    assert all("slew" in name for name in dropped)
    assert ACTION_NAMES[Mode.SPATIAL][-1] == "release"
    assert set(ACTION_NAMES[Mode.SPATIAL]) - set(ACTION_NAMES[Mode.PLANAR]) == {"slew_velocity"}
    assert RELEASE_THRESHOLD_RATIO == 0.9


@each("mode", list(Mode))
def test_the_papers_reward_is_a_configuration_beside_ours(mode: Mode):
    """Same machine and sensors; other pay, targets on the ground, and the paper's release and end."""
    ours, theirs = task_for(mode, "impact"), task_for(mode, "paper")
    assert (ours.reward.kind, theirs.reward.kind) == ("impact", "paper")
    differs = {k for k, v in asdict(theirs.episode).items() if v != asdict(ours.episode)[k]}
    assert differs == {
        "after_release",
        "override_probability_ratio",
        "target_height_m",
        "reach_at_height_m",
        "aim_margin_m",
        "pace_ratio",
    }
    assert theirs.episode.target_height_m == (0.0, 0.0) and theirs.episode.pace_ratio is None
    assert theirs.episode.after_release == "policy"
    assert theirs.episode.override_probability_ratio == 0.05
    assert replace(theirs, reward=ours.reward, episode=ours.episode) == ours
    weights = {k: v for k, v in asdict(RewardConfig(kind="paper")).items() if k.endswith("ratio")}
    for name in (
        "approach_ratio",
        "closeness_ratio",
        "closeness_per_m2_ratio",
        "landing_per_m2_ratio",
    ):
        assert weights[name] > 0.0, "all weights b and c are positive"


def test_release_and_friction_are_those_identified_in_the_paper():
    passive = PassiveConfig()
    low, high = passive.release_delay_mean_s
    assert low < 0.258 < high
    assert passive.release_delay_sd_s == 0.015
    assert SPEC.passive.viscous_friction_per_s == 0.03
    assert SPEC.passive.coulomb_friction_rad_per_s2 == 0.1
    low, high = passive.friction_scale_ratio
    assert low < 1.0 < high
