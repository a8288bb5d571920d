"""Export of a policy folder: ONNX file with the normaliser inside, and the card beside it.

Before the card is written, the file's actions are compared with those of the JAX actor; a relative
difference above 1e-5 is an error.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper

from machine.conventions import Array, Mode
from machine.errors import PolicyError
from machine.golden_vectors import golden_observations, write_golden_vectors
from machine.policy_card import (
    CARD_FILE,
    POLICY_FILE,
    PolicyCard,
    TrainingRecord,
    file_sha256,
)
from machine.spec import MachineSpec
from runtime.control.observation import ACTION_NAMES, observation_names
from training.environment.task import TaskConfig
from training.measure import act
from training.networks import NORMALISED_LIMIT, Layers, Normaliser

OPSET = 17
"""Operator set version; supported by onnxruntime since 1.12."""
IR_VERSION = 8
PARITY_LIMIT_RATIO = 1e-5


def policy_model(actor: Layers, normaliser: Normaliser) -> onnx.ModelProto:
    """Build the graph: observation -> (x - mean) / sqrt(var + eps) -> clip -> dense + ELU ... -> action."""
    width, actions = actor[0][0].shape[0], actor[-1][0].shape[1]
    scale = 1.0 / np.sqrt(np.asarray(normaliser.variance[:width], np.float64) + 1e-6)
    tensors = {
        "mean": np.asarray(normaliser.mean[:width], np.float32),
        "scale": scale.astype(np.float32),
        "low": np.asarray(-NORMALISED_LIMIT, np.float32),
        "high": np.asarray(NORMALISED_LIMIT, np.float32),
    }
    nodes = [
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Mul", ["centred", "scale"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["hidden_0"]),
    ]
    for index, (weights, bias) in enumerate(actor):
        tensors[f"weights_{index}"] = np.asarray(weights, np.float32)
        tensors[f"bias_{index}"] = np.asarray(bias, np.float32)
        last = index == len(actor) - 1
        out = "action" if last else f"linear_{index}"
        inputs = [f"hidden_{index}", f"weights_{index}", f"bias_{index}"]
        nodes.append(helper.make_node("Gemm", inputs, [out]))
        if not last:
            nodes.append(helper.make_node("Elu", [out], [f"hidden_{index + 1}"]))
    graph = helper.make_graph(
        nodes,
        "throw_policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", width])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", actions])],
        [numpy_helper.from_array(value, name) for name, value in tensors.items()],
    )
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="downrange",
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def parity_error(model: onnx.ModelProto, actor: Layers, normaliser: Normaliser) -> float:
    """Largest difference between the file's and the JAX actor's actions over 4096 observations.

    Relative for actions beyond 1 (which are clipped later), since single precision rounds them by more.
    """
    rng = np.random.default_rng(0)
    width = actor[0][0].shape[0]
    spread = 3.0 * np.sqrt(np.asarray(normaliser.variance[:width]) + 1e-6)
    seen = np.asarray(normaliser.mean[:width]) + spread * rng.standard_normal((4096, width))
    seen = seen.astype(np.float32)
    session = ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    exported = np.asarray(session.run(["action"], {"observation": seen})[0])
    trained = np.asarray(act(actor, normaliser, seen))
    return float((np.abs(exported - trained) / np.maximum(np.abs(trained), 1.0)).max())


def export_policy(
    folder: Path,
    policy_id: str,
    spec: MachineSpec,
    task: TaskConfig,
    actor: Layers,
    normaliser: Normaliser,
    training: TrainingRecord,
    evaluation: Sequence[dict[str, Any]] = (),
) -> PolicyCard:
    """Write `folder`/policy.onnx, golden_vectors.json and card.json.

    Raises:
        PolicyError: the file's actions differ from those of the trained network.
    """
    model = policy_model(actor, normaliser)
    worst = parity_error(model, actor, normaliser)
    if not worst <= PARITY_LIMIT_RATIO:
        raise PolicyError(
            f"exported policy {policy_id} differs from the trained network by {worst:.2e} "
            f"(limit {PARITY_LIMIT_RATIO:.0e}); export on the CPU, where matrix products are exact"
        )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / POLICY_FILE
    path.write_bytes(model.SerializeToString())
    width = actor[0][0].shape[0]
    deviation = np.sqrt(np.asarray(normaliser.variance[:width], np.float64) + 1e-6)
    seen = golden_observations(np.asarray(normaliser.mean[:width], np.float64), deviation)
    # The trained network's own actions, not the file's: the vectors also tell of a wrong export.
    write_golden_vectors(folder, seen, np.asarray(act(actor, normaliser, seen)))
    nearest, farthest = task.episode.target_range_m
    card = PolicyCard(
        policy_id=policy_id,
        mode=task.mode,
        policy_sha256=file_sha256(path),
        model_sha256=spec.sha256,
        observation_names=observation_names(task.mode, task.episode.pace_ratio is not None),
        action_names=ACTION_NAMES[task.mode],
        action_scale_rad_m_per_s=tuple(float(v) for v in action_scale(spec, task.mode)),
        # Targets at the end of the training range have neighbours on one side only: stay 5 cm inside.
        target_range_min_m=nearest,
        target_range_max_m=math.floor(10.0 * farthest) / 10.0,
        target_height_min_m=task.episode.target_height_m[0],
        target_height_max_m=task.episode.target_height_m[1],
        reach_at_height_m=_reach_inside(task.episode.reach_at_height_m),
        training=training,
        evaluation=list(evaluation),
    )
    text = card.model_dump_json(indent=2)
    (folder / CARD_FILE).write_text(text + "\n", encoding="utf-8")
    return card


def _reach_inside(reach_m: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Ranges rounded down to tenths of a metre, 5 cm inside the trained range where that ends on a half."""
    return tuple((height_m, math.floor(10.0 * far_m) / 10.0) for height_m, far_m in reach_m)


def action_scale(spec: MachineSpec, mode: Mode) -> Array:
    """Velocity of an action of 1 in joint order: the faster direction's limit, rad/s and m/s."""
    limits = spec.limits
    scale = np.maximum(limits.speed_positive_rad_m_per_s, limits.speed_negative_rad_m_per_s)
    return scale[1:] if mode is Mode.PLANAR else scale
