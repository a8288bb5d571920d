"""Accuracy is measured: on the CPU as well, where one scan over the steps never came back."""

import jax
import pytest

from machine.conventions import Mode
from tests.training.tiny_training import SPEC, small_task
from training.measure import Measurement
from training.networks import make_layers, make_normaliser
from training.train import accuracy_line


@pytest.mark.long
def test_a_policy_that_never_opens_runs_out_of_time_at_every_distance():
    actor = make_layers(jax.random.key(0), (57, 8, 4), 0.0)
    throws = Measurement(SPEC, small_task(Mode.PLANAR), (7.0, 9.0), 2, seed=1)
    seen = throws.accuracy(actor, make_normaliser(60))
    assert [entry.range_m for entry in seen] == [7.0, 9.0]
    assert [entry.failure_count for entry in seen] == [{"timeout": 2}, {"timeout": 2}]
    assert accuracy_line(seen[0]) == "  7.00 m  landed 0/2  2 timeout"
