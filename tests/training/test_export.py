"""The exported file does what the trained network does, and the runtime takes it."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, POLICY_FILE, PolicyCard, TrainingRecord, file_sha256
from runtime.control.observation import ACTION_NAMES, observation_names
from runtime.control.policy import PolicyRunner
from tests.training.tiny_training import SPEC, host
from training import export
from training.environment.configurations import task_for
from training.export import export_policy, parity_error, policy_model
from training.measure import act
from training.networks import Layers, Normaliser, make_layers
from training.train import _plain


class Exported(NamedTuple):
    folder: Path
    card: PolicyCard
    actor: Layers
    normaliser: Normaliser


def _network(mode: Mode) -> tuple[Layers, Normaliser]:
    """The shipped sizes, random, with a normaliser as uneven as a trained one."""
    width, actions = len(observation_names(mode, True)), len(ACTION_NAMES[mode])
    actor = make_layers(jax.random.key(1), (width, 256, 128, actions), 1.0)
    rng = np.random.default_rng(2)
    # The critic's privileged inputs are normalised by the same moments: the file must leave them out.
    moments = rng.normal(0.0, 3.0, width + 7), 10.0 ** rng.uniform(-4.0, 2.0, width + 7)
    return host(actor), Normaliser(*(np.asarray(m, np.float32) for m in moments), np.float32(1e6))


RECORD = TrainingRecord(
    commit="0" * 40,
    seed_count=3,
    environment_step_count=1000,
    iteration_count=4,
    wall_s=1.5,
    device="cpu",
    config={"task": "of a test"},
)


@pytest.fixture(scope="module", params=list(Mode), ids=lambda mode: mode.value)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Exported:
    mode: Mode = request.param
    actor, normaliser = _network(mode)
    folder = tmp_path_factory.mktemp("export") / f"test-{mode.value}"
    accuracy: list[dict[str, Any]] = [{"plant": "training", "throws": []}]
    card = export_policy(
        folder, folder.name, SPEC, task_for(mode), actor, normaliser, RECORD, accuracy
    )
    return Exported(folder, card, actor, normaliser)


def test_the_runtimes_actions_are_those_of_the_trained_network(exported: Exported):
    runner = PolicyRunner(exported.folder, SPEC)
    width = len(exported.card.observation_names)
    spread = np.sqrt(exported.normaliser.variance[:width])
    rng = np.random.default_rng(3)
    # Within the range seen in training, and far beyond it, where the normaliser clips.
    for factor in (1.0, 30.0):
        seen = exported.normaliser.mean[:width] + factor * spread * rng.standard_normal(
            (500, width)
        )
        seen = seen.astype(np.float32)
        ours = np.asarray(act(exported.actor, exported.normaliser, jnp.asarray(seen)))
        assert np.abs(ours).max() > 0.5
        np.testing.assert_allclose(runner.act(seen), ours, rtol=0.0, atol=1e-5)


def test_the_normaliser_is_inside(exported: Exported):
    runner = PolicyRunner(exported.folder, SPEC)
    width = len(exported.card.observation_names)
    mean = exported.normaliser.mean[:width]
    # At the mean every normalised input is zero, and the biases of a fresh network are zero.
    np.testing.assert_allclose(runner.act(mean[None]), 0.0, atol=1e-6)
    far = mean + 1e6 * np.sqrt(exported.normaliser.variance[:width])
    farther = mean + 1e7 * np.sqrt(exported.normaliser.variance[:width])
    np.testing.assert_array_equal(runner.act(far[None]), runner.act(farther[None]))


def test_the_card_says_what_the_file_is(exported: Exported):
    stored = json.loads((exported.folder / CARD_FILE).read_text(encoding="utf-8"))
    card = PolicyCard.model_validate(stored)
    assert card == exported.card
    assert card.policy_sha256 == file_sha256(exported.folder / POLICY_FILE)
    assert card.model_sha256 == SPEC.sha256
    assert card.policy_id == exported.folder.name
    assert card.observation_names == observation_names(card.mode, True)
    assert card.action_names == ACTION_NAMES[card.mode]
    limits = SPEC.limits
    fastest = np.maximum(limits.speed_positive_rad_m_per_s, limits.speed_negative_rad_m_per_s)
    first = 0 if card.mode is Mode.SPATIAL else 1
    # Not rounded: what trained with a scale must drive with the same.
    assert card.action_scale_rad_m_per_s == tuple(float(v) for v in fastest[first:])
    near, far = task_for(card.mode).episode.target_range_m
    assert card.target_range_min_m == near
    assert far - 0.1 <= card.target_range_max_m <= far
    assert card.training == RECORD
    assert card.evaluation == [{"plant": "training", "throws": []}]


def test_the_tasks_configuration_can_stand_in_a_card():
    for mode in Mode:
        whole = json.loads(json.dumps(_plain(asdict(task_for(mode)))))
        assert set(whole) == set(asdict(task_for(mode)))
        assert whole["episode"]["target_range_m"] == list(task_for(mode).episode.target_range_m)


def test_a_file_that_differs_from_the_network_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    actor, normaliser = _network(Mode.PLANAR)
    bent = (*actor[:-1], (actor[-1][0], actor[-1][1] + 1e-3))
    model = policy_model(bent, normaliser)
    assert parity_error(model, actor, normaliser) == pytest.approx(1e-3, rel=0.05)
    monkeypatch.setattr(export, "policy_model", lambda *_: model)
    with pytest.raises(PolicyError, match="differs from the trained network"):
        export_policy(
            tmp_path / "bent", "bent", SPEC, task_for(Mode.PLANAR), actor, normaliser, RECORD
        )
    assert not (tmp_path / "bent").exists()
