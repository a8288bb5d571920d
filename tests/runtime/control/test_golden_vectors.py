"""Networks that were permuted, rescaled or normalised otherwise are refused when they are loaded."""

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from machine.errors import PolicyError
from machine.golden_vectors import GoldenVectors, read_golden_vectors
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, file_sha256, read_policy
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner
from tests.cases import each

SHIPPED = Path(__file__).parents[3] / "policies"
SPEC = load_spec()


@pytest.fixture(params=["m545-2d-v7", "m545-3d-v7"])
def folder(request, tmp_path):
    return Path(shutil.copytree(SHIPPED / request.param, tmp_path / request.param))


def rewrite(folder, change):
    """Change tensors of the network, and let the card name the new file's hash."""
    model = onnx.load(str(folder / POLICY_FILE))
    tensors = {one.name: numpy_helper.to_array(one).copy() for one in model.graph.initializer}
    change(tensors)
    for one in model.graph.initializer:
        one.CopyFrom(numpy_helper.from_array(tensors[one.name].astype(np.float32), one.name))
    onnx.save(model, str(folder / POLICY_FILE))
    card = json.loads((folder / CARD_FILE).read_text())
    card["policy_sha256"] = file_sha256(folder / POLICY_FILE)
    (folder / CARD_FILE).write_text(json.dumps(card))


def test_the_shipped_ones_load_with_their_vectors(folder):
    runner = PolicyRunner(folder, SPEC)
    golden = read_golden_vectors((folder / GOLDEN_FILE).read_bytes(), "it")
    found = runner.infer(np.asarray(golden.observations))
    assert np.abs(found - np.asarray(golden.actions)).max() <= golden.tolerance
    # Numbers that a computer's matrix products may differ in are far below the tolerance.
    assert len(golden.observations) == 16


def test_any_two_inputs_that_change_places_are_refused(folder):
    """Every pair of neighbours, at the first layer, as an exporter that sorts names would."""
    files = read_policy(folder)
    golden = read_golden_vectors(files.golden, "it")
    runner = PolicyRunner(files, SPEC)
    seen = np.asarray(golden.observations)
    for place in range(seen.shape[1] - 1):
        order = np.arange(seen.shape[1])
        order[[place, place + 1]] = order[[place + 1, place]]
        with pytest.raises(PolicyError, match="inputs, outputs or normaliser are not those"):
            golden.check(
                lambda given, order=order: runner.infer(given[:, order]),
                runner.card.action_names,
                "it",
            )


def permuted_inputs(tensors):
    for name in ("mean", "scale"):
        tensors[name][[0, 1]] = tensors[name][[1, 0]]
    tensors["weights_0"][[0, 1]] = tensors["weights_0"][[1, 0]]


def rescaled_outputs(tensors):
    last = max(name for name in tensors if name.startswith("weights_"))
    tensors[last] *= 1.01
    tensors[last.replace("weights", "bias")] *= 1.01


def permuted_outputs(tensors):
    last = max(name for name in tensors if name.startswith("weights_"))
    tensors[last] = tensors[last][:, ::-1]


def no_normaliser(tensors):
    tensors["mean"][:] = 0.0
    tensors["scale"][:] = 1.0


def other_mean(tensors):
    tensors["mean"] += 0.02 / tensors["scale"]


@each(
    "change",
    [permuted_inputs, rescaled_outputs, permuted_outputs, no_normaliser, other_mean],
    copied="folder",
)
def test_what_was_done_to_the_network_is_seen_at_load(folder, change):
    rewrite(folder, lambda tensors: None)
    PolicyRunner(folder, SPEC)
    rewrite(folder, change)
    words = (
        r"golden observation \d+, golden_vectors\.json says .*not those that it was trained with"
    )
    with pytest.raises(PolicyError, match=words):
        PolicyRunner(folder, SPEC)


def test_a_network_that_gives_no_numbers_is_refused(folder):
    files = read_policy(folder)
    golden = read_golden_vectors(files.golden, "it")
    shape = np.asarray(golden.actions).shape
    with pytest.raises(PolicyError, match=r"gives .* = nan"):
        golden.check(lambda given: np.full(shape, np.nan), files.card.action_names, "it")


@each(
    ("change", "words"),
    [
        (lambda body: body.pop("actions"), "actions"),
        (lambda body: body["actions"].pop(), "as many"),
        (lambda body: body["observations"][0].pop(), "each of one width"),
        (lambda body: body.update(tolerance=0.5), "tolerance"),
        (lambda body: body.update(observations=body["observations"][:4]), "observations"),
        (lambda body: body["actions"][0].__setitem__(0, 1e999), "finite"),
    ],
    copied="folder",
)
def test_a_file_that_would_check_nothing_is_refused(folder, change, words):
    body = json.loads((folder / GOLDEN_FILE).read_text())
    change(body)
    (folder / GOLDEN_FILE).write_text(json.dumps(body))
    with pytest.raises(PolicyError, match=rf"(?s)golden_vectors\.json cannot be used: .*{words}"):
        PolicyRunner(folder, SPEC)


def test_a_narrower_file_is_refused_in_words(folder):
    golden = read_golden_vectors((folder / GOLDEN_FILE).read_bytes(), "it")
    narrow = GoldenVectors(
        observations=tuple(row[:-1] for row in golden.observations), actions=golden.actions
    )
    (folder / GOLDEN_FILE).write_text(narrow.model_dump_json())
    with pytest.raises(PolicyError, match="got observations of shape"):
        PolicyRunner(folder, SPEC)
    names = read_policy(folder).card.action_names
    with pytest.raises(PolicyError, match="the card names"):
        golden.check(lambda given: given, names[:-1], "it")


def test_what_is_loaded_is_what_was_read(folder):
    """The network is exchanged on the disk between the check of its approval and its load."""
    files = read_policy(folder)
    (folder / POLICY_FILE).write_bytes(b"another network")
    assert PolicyRunner(files, SPEC).card == files.card
    with pytest.raises(PolicyError, match="was changed or cut off"):
        PolicyRunner(folder, SPEC)


@each("field", ["policy_rate_hz", "control_rate_hz"], copied="folder")
def test_another_rate_is_refused(folder, field):
    card = json.loads((folder / CARD_FILE).read_text())
    (folder / CARD_FILE).write_text(json.dumps(card | {field: 50.0}))
    with pytest.raises(PolicyError, match="50 Hz"):
        PolicyRunner(folder, SPEC)


@each("row_count", [1, 3])
def test_actions_of_another_shape_are_refused_in_words(folder, row_count):
    files = read_policy(folder)
    golden = read_golden_vectors(files.golden, "it")
    names = files.card.action_names
    with pytest.raises(PolicyError, match=rf"gives actions of shape \({row_count}, "):
        golden.check(lambda given: np.zeros((row_count, len(names))), names, "it")
    runner = PolicyRunner(files, SPEC)

    class Session:
        def run(self, names, given):
            return [np.zeros((row_count, len(runner.card.action_names)))]

    runner._session = Session()
    with pytest.raises(PolicyError, match=rf"gave actions of shape \({row_count}, .*needs \(2, "):
        runner.act(np.zeros((2, len(runner.card.observation_names))))
