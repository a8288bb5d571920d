"""A hand-made policy that opens the dipper a little and lets go: a whole throw in about a second."""

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from machine.conventions import Mode
from machine.policy_card import CARD_FILE, POLICY_FILE, PolicyCard, TrainingRecord, file_sha256
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.observation import ACTION_NAMES, OBSERVATION_NAMES
from scripts.golden_vectors import add_golden_vectors

MOVE_RAD = 0.15
DIPPER_ACTION = 0.3


def write_policies(root: Path) -> Path:
    """A policies folder with both modes; returns it."""
    for mode in Mode:
        write_policy(root / f"quick-{mode.value}", mode)
    active = {mode.value: f"quick-{mode.value}" for mode in Mode}
    (root / "active.json").write_text(json.dumps(active), encoding="utf-8")
    return root


def write_policy(folder: Path, mode: Mode, move_rad: float = MOVE_RAD) -> str:
    """One version that lets go after the dipper has moved so far; returns its sha256."""
    names, actions = OBSERVATION_NAMES[mode], ACTION_NAMES[mode]
    weights, bias = np.zeros((len(names), len(actions))), np.zeros(len(actions))
    bias[actions.index("dipper_velocity")] = np.arctanh(DIPPER_ACTION)
    release = actions.index("release")
    weights[names.index("dipper_position_k"), release] = 200.0
    bias[release] = -200.0 * (safe_pose()[2] + move_rad)
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["observation", "W", "b"], ["raw"]),
            helper.make_node("Tanh", ["raw"], ["action"]),
        ],
        "quick",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", len(weights)])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", len(bias)])],
        [
            numpy_helper.from_array(weights.astype(np.float32), "W"),
            numpy_helper.from_array(bias.astype(np.float32), "b"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    folder.mkdir(parents=True)
    onnx.save(model, str(folder / POLICY_FILE))
    spec = load_spec()
    scale = np.maximum(
        spec.limits.speed_positive_rad_m_per_s, spec.limits.speed_negative_rad_m_per_s
    )
    card = PolicyCard(
        policy_id=folder.name,
        mode=mode,
        policy_sha256=file_sha256(folder / POLICY_FILE),
        model_sha256=spec.sha256,
        observation_names=names,
        action_names=actions,
        action_scale_rad_m_per_s=tuple(scale if mode is Mode.SPATIAL else scale[1:]),
        target_range_min_m=5.5,
        target_range_max_m=10.9,
        target_height_max_m=1.0,
        training=TrainingRecord(
            commit="none",
            seed_count=0,
            environment_step_count=0,
            iteration_count=0,
            wall_s=0.0,
            device="by hand",
            config={},
        ),
    )
    (folder / CARD_FILE).write_text(card.model_dump_json(), encoding="utf-8")
    add_golden_vectors(folder)
    return card.policy_sha256
