import json
import shutil
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, PolicyCard, file_sha256
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner, find_policy
from tests.cases import each

SPEC = load_spec()


@pytest.fixture
def folder(swing_policies, tmp_path):
    copy = tmp_path / "swing-2d"
    shutil.copytree(swing_policies / "swing-2d", copy)
    return copy


def change_card(folder, **changes):
    card = PolicyCard.model_validate_json((folder / CARD_FILE).read_text())
    text = card.model_copy(update=changes).model_dump_json()
    (folder / CARD_FILE).write_text(text)


def put_model(folder, model):
    onnx.save(model, str(folder / POLICY_FILE))
    change_card(folder, policy_sha256=file_sha256(folder / POLICY_FILE))


def linear(
    width=56,
    actions=4,
    batch="batch",
    name="observation",
    out="action",
    bias=0.0,
    kind=TensorProto.FLOAT,
):
    dtype = np.float32 if kind == TensorProto.FLOAT else np.float64
    graph = helper.make_graph(
        [helper.make_node("Gemm", [name, "W", "b"], [out])],
        "g",
        [helper.make_tensor_value_info(name, kind, [batch, width])],
        [helper.make_tensor_value_info(out, kind, [batch, actions])],
        [
            numpy_helper.from_array(np.zeros((width, actions), dtype), "W"),
            numpy_helper.from_array(np.full(actions, bias, dtype), "b"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    return model


@each("mode", list(Mode))
def test_a_policy_acts(swing_policies, mode):
    runner = PolicyRunner(find_policy(swing_policies, mode), SPEC)
    width, actions = (56, 4) if mode is Mode.PLANAR else (65, 5)
    observation = np.random.default_rng(0).normal(size=(7, width))
    action = runner.act(observation)
    assert action.shape == (7, actions) and action.dtype == np.float64
    one_by_one = np.concatenate([runner.act(row[None]) for row in observation])
    assert np.allclose(action, one_by_one, atol=1e-6)
    assert runner.card.mode is mode
    assert runner.action_scale_rad_m_per_s.shape == (actions - 1,)


def test_a_truncated_file_is_refused(folder):
    data = (folder / POLICY_FILE).read_bytes()
    (folder / POLICY_FILE).write_bytes(data[: len(data) // 2])
    with pytest.raises(PolicyError, match=r"cut off.*copy"):
        PolicyRunner(folder, SPEC)


def test_a_truncated_file_with_a_matching_hash_is_refused(folder):
    data = (folder / POLICY_FILE).read_bytes()
    (folder / POLICY_FILE).write_bytes(data[: len(data) // 2])
    change_card(folder, policy_sha256=file_sha256(folder / POLICY_FILE))
    with pytest.raises(PolicyError, match="not a usable ONNX file"):
        PolicyRunner(folder, SPEC)


def test_another_machines_policy_is_refused(folder):
    change_card(folder, model_sha256="f" * 64)
    with pytest.raises(PolicyError, match=f"ffffffffffff.*{SPEC.sha256[:12]}"):
        PolicyRunner(folder, SPEC)


def test_other_names_are_refused(folder):
    card = PolicyCard.model_validate_json((folder / CARD_FILE).read_text())
    swapped = (card.observation_names[1], card.observation_names[0], *card.observation_names[2:])
    change_card(folder, observation_names=swapped)
    with pytest.raises(PolicyError, match="number 0 is 'dipper_position_k'"):
        PolicyRunner(folder, SPEC)
    change_card(folder, observation_names=card.observation_names[:-1])
    with pytest.raises(PolicyError, match="55 names, should be 56"):
        PolicyRunner(folder, SPEC)
    change_card(folder, observation_names=card.observation_names, action_names=("a", "b", "c", "d"))
    with pytest.raises(PolicyError, match="4 actions"):
        PolicyRunner(folder, SPEC)


def test_a_policy_may_end_with_the_pace(folder):
    assert not PolicyRunner(folder, SPEC).is_paced
    card = PolicyCard.model_validate_json((folder / CARD_FILE).read_text())
    put_model(folder, linear(width=57))
    (folder / GOLDEN_FILE).unlink()
    change_card(
        folder,
        observation_names=(*card.observation_names, "pace"),
        policy_sha256=file_sha256(folder / POLICY_FILE),
    )
    runner = PolicyRunner(folder, SPEC)
    assert runner.is_paced
    assert runner.act(np.zeros((2, 57))).shape == (2, 4)


@each("scale", [(0.5, 0.7), (0.5, 0.7, 0.0), (0.5, 0.7, float("nan"))])
def test_scales_must_be_positive_numbers(folder, scale):
    text = json.loads((folder / CARD_FILE).read_text())
    text["action_scale_rad_m_per_s"] = list(scale)
    (folder / CARD_FILE).write_text(json.dumps(text))
    with pytest.raises(PolicyError, match=r"positive numbers|no finite number"):
        PolicyRunner(folder, SPEC)


@each(
    "change",
    [
        {"width": 55},
        {"actions": 5},
        {"batch": 1},
        {"name": "input"},
        {"out": "output"},
        {"kind": TensorProto.DOUBLE},
    ],
)
def test_other_tensors_are_refused(folder, change):
    put_model(folder, linear(**change))
    with pytest.raises(PolicyError, match="expected one float tensor"):
        PolicyRunner(folder, SPEC)


@each("bad", [np.nan, np.inf])
def test_an_action_that_is_no_number_is_refused_at_loading(folder, bad):
    put_model(folder, linear(bias=bad))
    with pytest.raises(PolicyError, match=r"boom_velocity = (nan|inf) for row 0 of 1"):
        PolicyRunner(folder, SPEC)


def test_an_action_that_is_no_number_later(swing_policies):
    runner = PolicyRunner(swing_policies / "swing-2d", SPEC)
    observation = np.zeros((3, 56))
    observation[1] = np.nan
    with pytest.raises(PolicyError, match="row 1 of 3"):
        runner.act(observation)
    raw = runner.infer(observation)
    assert np.isfinite(raw).all(axis=1).tolist() == [True, False, True]


class SlowSession:
    """A session whose runs take so much processor time, and so much time, of a clock of its own."""

    def __init__(self, session, processor_s, wall_s):
        self.session, self.took = session, (processor_s, wall_s)
        self.busy_s = self.now_s = 0.0
        self.clock = SimpleNamespace(
            thread_time=lambda: self.busy_s, perf_counter=lambda: self.now_s
        )

    def run(self, *arguments):
        self.busy_s += self.took[0]
        self.now_s += self.took[1]
        return self.session.run(*arguments)


@each(
    "processor_s, wall_s, is_late",
    [(0.0, 0.0, False), (0.011, 0.011, True), (0.009, 0.099, False), (0.0, 0.101, True)],
)
def test_a_run_that_takes_too_long_for_its_tick_is_late(
    processor_s, wall_s, is_late, swing_policies, monkeypatch
):
    for has_deadline in (True, False):
        runner = PolicyRunner(swing_policies / "swing-2d", SPEC, has_deadline=has_deadline)
        slow = SlowSession(runner._session, processor_s, wall_s)
        runner._session = slow
        with monkeypatch.context() as patch:
            patch.setattr("runtime.control.policy.time", slow.clock)
            runner.infer(np.zeros((1, 56)))
        assert runner.is_late == (has_deadline and is_late)


def test_an_observation_of_the_wrong_width(swing_policies):
    runner = PolicyRunner(swing_policies / "swing-2d", SPEC)
    with pytest.raises(PolicyError, match=r"\(1, 65\).*\(N, 56\)"):
        runner.act(np.zeros((1, 65)))


def test_missing_files(folder):
    (folder / CARD_FILE).unlink()
    with pytest.raises(PolicyError, match="is missing"):
        PolicyRunner(folder, SPEC)


def test_find_policy(tmp_path):
    with pytest.raises(PolicyError, match="cannot be read"):
        find_policy(tmp_path, Mode.PLANAR)
    active = tmp_path / "active.json"
    active.write_text("{")
    with pytest.raises(PolicyError, match="cannot be read"):
        find_policy(tmp_path, Mode.PLANAR)
    for content in ("[]", "{}", '{"3d": "x"}', '{"2d": 3}'):
        active.write_text(content)
        with pytest.raises(PolicyError, match="no policy for mode 2d"):
            find_policy(tmp_path, Mode.PLANAR)
    active.write_text('{"2d": "here"}')
    with pytest.raises(PolicyError, match="no policy folder"):
        find_policy(tmp_path, Mode.PLANAR)
    (tmp_path / "here").mkdir()
    assert find_policy(tmp_path, Mode.PLANAR) == tmp_path / "here"


@each("name", ["..", "../elsewhere", "/etc", "."], copied="tmp_path")
def test_an_id_is_never_a_path(tmp_path, name):
    root = tmp_path / "policies"
    root.mkdir()
    (tmp_path / "elsewhere").mkdir()
    (root / "active.json").write_text(json.dumps({"2d": name}))
    with pytest.raises(PolicyError, match="no policy folder"):
        find_policy(root, Mode.PLANAR)
