"""Fixtures that several packages' tests share."""

import json
import os
import shutil
import tempfile
from collections import Counter
from pathlib import Path

# Before numpy is loaded, and for processes that tests start: BLAS threads of two test processes on two cores
# spend half of their time waiting for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

from machine.conventions import Mode
from machine.policy_card import CARD_FILE, POLICY_FILE, PolicyCard, TrainingRecord, file_sha256
from machine.spec import load_spec
from runtime.control.observation import ACTION_NAMES, OBSERVATION_NAMES

# A busy machine must not fail a property: examples have no time limit of their own. They are the same in
# every run, so that a red run is about the change; --hypothesis-profile=explore looks further.
settings.register_profile("downrange", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None, max_examples=1000)
settings.load_profile("downrange")

MEMORY = Path("/dev/shm")
MEMORY_LEAST_BYTES = 3_000_000_000
"""A run leaves less than 0.5 GB in its folders."""


def pytest_configure() -> None:
    """Folders of tests lie in memory if there is enough.

    Databases sync after every transaction, for which a computer's disk may take a hundredth of a second.
    """
    if "TMPDIR" in os.environ or not os.access(MEMORY, os.W_OK):
        return
    if shutil.disk_usage(MEMORY).free > MEMORY_LEAST_BYTES:
        os.environ["TMPDIR"] = str(MEMORY)
        tempfile.tempdir = None


WHOLE_FOLDERS = ("training",)
"""Compiled environments of the session take long to build: once, not in every worker."""


def _unit_of(nodeid: str) -> str:
    """The file, or the whole folder, whose tests run in one worker."""
    path = nodeid.split("::", 1)[0]
    folder = path.split("/")[1]
    return folder if folder in WHOLE_FOLDERS else path


class FolderScheduling(LoadFileScheduling):
    """Tests of a file, or of a whole folder, run in one worker."""

    def _split_scope(self, nodeid: str) -> str:
        return _unit_of(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> FolderScheduling:
    # The order is that of the collection, below.
    config.option.loadscopereorder = False
    return FolderScheduling(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Several workers begin with the files that say so; those with the fewest tests come last."""
    if not hasattr(config, "workerinput"):
        return
    counts = Counter(_unit_of(item.nodeid) for item in items)
    items.sort(
        key=lambda item: (
            item.get_closest_marker("begins_first") is None,
            -counts[_unit_of(item.nodeid)],
        )
    )


RELEASE_SPEED_M_PER_S = 0.6
"""The 2D throw from the safe pose then takes 1.2 s and lands 6.0 m away."""


def _weights(mode: Mode, throws: bool) -> tuple[np.ndarray, np.ndarray]:
    """Linear map of a hand-made policy: the dipper pumps the swing, the load goes when it flies fast.

    A pin that moves against the swing angle accelerates with the swing, which feeds it.
    """
    names, actions = OBSERVATION_NAMES[mode], ACTION_NAMES[mode]
    weights, bias = np.zeros((len(names), len(actions))), np.zeros(len(actions))
    bias[-1] = -1.0
    if not throws:
        return weights, bias
    dipper, release = actions.index("dipper_velocity"), actions.index("release")
    for joint in ("boom", "dipper", "pitch"):
        weights[names.index(f"{joint}_position_k"), dipper] = -5.0
        weights[names.index(f"{joint}_velocity_k"), dipper] = 0.6
    bias[dipper] = 0.25
    weights[names.index("grip_velocity_x"), release] = 6.0
    bias[release] = -6.0 * RELEASE_SPEED_M_PER_S + 1.5
    if mode is Mode.SPATIAL:
        slew = actions.index("slew_velocity")
        weights[names.index("slew_position_k"), slew] = -1.0
    return weights, bias


def write_swing_policy(folder: Path, mode: Mode, throws: bool = True) -> None:
    """A policy folder whose ONNX file is tanh(observation @ W + b)."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    from scripts.golden_vectors import add_golden_vectors

    weights, bias = _weights(mode, throws)
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["observation", "W", "b"], ["raw"]),
            helper.make_node("Tanh", ["raw"], ["action"]),
        ],
        "swing",
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
        observation_names=OBSERVATION_NAMES[mode],
        action_names=ACTION_NAMES[mode],
        action_scale_rad_m_per_s=tuple(
            float(v) for v in (scale if mode is Mode.SPATIAL else scale[1:])
        ),
        target_range_min_m=5.5,
        target_range_max_m=10.9,
        target_height_min_m=-0.8,
        target_height_max_m=0.8,
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
    (folder / CARD_FILE).write_text(card.model_dump_json(indent=2), encoding="utf-8")
    add_golden_vectors(folder)


@pytest.fixture(scope="session")
def swing_policies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policies folder with a hand-made policy of each mode: it throws, but aims at nothing.

    Beside them ``waits-2d`` and ``waits-3d``, which stand still.
    """
    root = tmp_path_factory.mktemp("policies")
    for mode in Mode:
        write_swing_policy(root / f"swing-{mode.value}", mode)
        write_swing_policy(root / f"waits-{mode.value}", mode, throws=False)
    active = {mode.value: f"swing-{mode.value}" for mode in Mode}
    (root / "active.json").write_text(json.dumps(active), encoding="utf-8")
    return root
