"""Write golden_vectors.json for policy folders that are known to be right.

`python -m scripts.golden_vectors policies/m545-2d-v7 ...`. Newly trained policies get theirs at export, from
the trained network; these are what the file itself gives, so they guard what is done to it from now on.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from machine.golden_vectors import golden_observations, write_golden_vectors
from machine.policy_card import POLICY_FILE
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner


def add_golden_vectors(folder: Path) -> None:
    """Write the file of one folder.

    Raises:
        PolicyError: the folder holds no usable policy.
    """
    runner = PolicyRunner(folder, load_spec())
    model = onnx.load(str(folder / POLICY_FILE))
    tensors = {one.name: numpy_helper.to_array(one) for one in model.graph.initializer}
    width = len(runner.card.observation_names)
    # A network without the exporter's normaliser is taken to see inputs of mean 0 and deviation 1.
    mean = np.asarray(tensors.get("mean", np.zeros(width)), np.float64)
    deviation = 1.0 / np.asarray(tensors.get("scale", np.ones(width)), np.float64)
    seen = golden_observations(mean, deviation)
    write_golden_vectors(folder, seen, runner.infer(seen))


if __name__ == "__main__":
    for name in sys.argv[1:]:
        add_golden_vectors(Path(name))
        print(name)
