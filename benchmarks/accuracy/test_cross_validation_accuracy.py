"""A late release is a gap that closes on held-out throws."""

from diagnosis.cross_validation import shrink
from diagnosis.hypotheses.gap_problem import pose_problem
from diagnosis.linearisation.parameters import layout
from diagnosis.loading.prepared import prepare
from sim_twin.effects.effect import Effect
from tests.diagnosis.test_cross_validation import posed_with
from tests.diagnosis.twin_throws import health, profile, throws


def test_a_late_release_is_a_gap_that_closes() -> None:
    known = health()
    late = Effect(effect="release_delay", parameters={"extra_delay_s": 0.08})
    loaded = throws((late,), 6)
    plan = layout(known.noise)
    prepared = prepare(loaded.throws, profile())
    calibration = loaded.throws[0].calibration
    one = pose_problem(prepared, profile(), calibration, known, plan)
    found = shrink(*posed_with(one, late), floor_m=0.3)
    assert found is not None
    assert found[0].ratio > 0.7
    assert found[0].ci90[0] > 0.0
