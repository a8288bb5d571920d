"""A policy version for tests: the active one with slightly other weights, as an export writes it."""

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, file_sha256
from scripts.golden_vectors import add_golden_vectors

ROOT = Path(__file__).parents[2]
RETRAINED = "m545-2d-retrained"


def retrained(folder: Path) -> Path:
    """The active version with slightly other weights, under a name of its own, as an export writes it."""
    shutil.copytree(ROOT / "policies" / "m545-2d-v7", folder)
    model = onnx.load(str(folder / POLICY_FILE))
    for tensor in model.graph.initializer:
        if tensor.name == "weights_1":
            weights = 1.001 * numpy_helper.to_array(tensor)
            tensor.CopyFrom(numpy_helper.from_array(weights.astype(np.float32), tensor.name))
    (folder / POLICY_FILE).write_bytes(model.SerializeToString())
    write_card(folder)
    (folder / GOLDEN_FILE).unlink()
    add_golden_vectors(folder)
    return folder


def write_card(folder: Path) -> None:
    card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
    card |= {"policy_id": RETRAINED, "policy_sha256": file_sha256(folder / POLICY_FILE)}
    (folder / CARD_FILE).write_text(json.dumps(card), encoding="utf-8")


def files_of(folder: Path) -> list[Path]:
    return [folder / name for name in (POLICY_FILE, CARD_FILE, GOLDEN_FILE)]
