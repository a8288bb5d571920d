"""What a machine's throws repeat is held by its filters; what a throw does alone is not."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.healthy.filters import HealthyModel, correction, nothing, sum_of
from diagnosis.linearisation.sensitivities import LinearThrow, linearise
from diagnosis.loading.prepared import PreparedThrow, prepare
from diagnosis.population.machine_filters import as_unseen, filters_help, machine_filters
from tests.diagnosis.twin_throws import profile, throws

DIPPER = 2


@pytest.fixture(scope="module")
def begun() -> tuple[list[PreparedThrow], list[LinearThrow]]:
    loaded = throws((), 8)
    prepared = prepare(loaded.throws, profile())
    return prepared, linearise(prepared, profile(), loaded.throws[0].calibration, nothing())


def moved(
    begun: tuple[list[PreparedThrow], list[LinearThrow]], shares: list[float]
) -> list[LinearThrow]:
    """The throws with a dipper that moves faster by a share of its speed, squared."""
    found: list[LinearThrow] = []
    for p, one, share in zip(*begun, shares, strict=True):
        residual, speed = one.residual.copy(), one.predicted_velocity[:, DIPPER]
        block = p.block("actuation.dipper")
        assert block is not None
        more = np.interp(p.joint_at_s, p.motion.t_s, share * speed * np.abs(speed))
        residual[block.rows] += p.joint_pair @ more
        found.append(replace(one, residual=residual))
    return found


def power(prepared: list[PreparedThrow], linear: list[LinearThrow]) -> float:
    rows = [p.block("actuation.dipper") for p in prepared]
    return sum(
        float(np.sum(one.residual[b.rows] ** 2)) for b, one in zip(rows, linear, strict=True) if b
    )


def test_what_every_throw_repeats_is_predicted_for_throws_that_were_not_seen(
    begun: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, before = begun
    repeated = moved(begun, [1.0] * 8)
    filters = machine_filters(prepared, repeated, nothing())
    left = as_unseen(prepared, repeated, nothing(), filters)
    gained = power(prepared, repeated) - power(prepared, before)
    assert power(prepared, left) < power(prepared, before) + 0.2 * gained


def test_what_one_throw_does_alone_stays(
    begun: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, _ = begun
    once = moved(begun, [1.0, *[0.0] * 7])
    left = as_unseen(prepared, once, nothing(), machine_filters(prepared, once, nothing()))
    assert power(prepared[:1], left[:1]) > 0.5 * power(prepared[:1], once[:1])


def test_two_models_correct_as_their_sum(
    begun: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, before = begun
    one = machine_filters(prepared, moved(begun, [1.0] * 8), nothing()).all
    two = machine_filters(prepared, moved(begun, [-0.4] * 8), nothing()).all
    p, track = prepared[0], before[0].predicted_velocity[:, DIPPER]

    def by(model: HealthyModel) -> np.ndarray:
        return correction(model, p.motion, DIPPER, track)

    np.testing.assert_allclose(by(sum_of(one, two)), by(one) + by(two), atol=1e-9)


def test_filters_that_raise_the_residual_do_not_help(
    begun: tuple[list[PreparedThrow], list[LinearThrow]],
) -> None:
    prepared, linear = begun
    linear = moved(begun, [0.3] * 8)
    own = machine_filters(prepared, linear, nothing()).all
    wrong = nothing().joints[0].model_copy(update={"offset": 0.1, "weight": (1e-9,) * 140})
    of_another = HealthyModel(note="another type", joints=(wrong,) * len(nothing().joints))
    for filters, is_better in ((own, True), (of_another, False)):
        under = linearise(prepared, profile(), prepared[0].throw.calibration, filters)
        more = [
            replace(one, residual=one.residual + off.residual - plain.residual)
            for one, off, plain in zip(under, linear, begun[1], strict=True)
        ]
        assert filters_help(prepared, more, filters) is is_better
