from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.calibration import nominal_calibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.kinematics import aligned_slew_rad, hanging_pitch_rad
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner
from sim_twin.throws.accuracy import (
    accuracy_table,
    bad_throws_text,
    outcome_counts,
    target_accuracy,
)
from sim_twin.throws.campaign import (
    ThrowOutcome,
    ThrowResult,
    landing_ellipse,
    run_throws,
    throw_errors,
)
from sim_twin.twin.profile import nominal_profile
from sim_twin.twin.twin import Twin

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)


def params(folder: Path, name: str = "swing-2d") -> ControlParams:
    runner = PolicyRunner(folder / name, SPEC)
    return ControlParams(spec=SPEC, calibration=CALIBRATION, mode=Mode.PLANAR, policy=runner)


def result(down: float, cross: float, outcome: ThrowOutcome = ThrowOutcome.LANDED) -> ThrowResult:
    return ThrowResult(
        (9.0, 0.0, 0.0), outcome, (9.0 + down, cross, 0.0), down, cross, 3.0, 1.0, 2.0
    )


def starts(target_m: np.ndarray) -> np.ndarray:
    return np.stack([safe_pose(float(aligned_slew_rad(SPEC, t[None])[0])) for t in target_m])


def test_throws_are_scored_and_repeat_with_their_seed(swing_policies: Path) -> None:
    """Five throws on two machines: three batches, the last one filled up."""
    target_m = np.array([[r, 0.0, 0.0] for r in (6.0, 6.5, 7.0, 6.5, 6.0)])
    told: list[tuple[int, int]] = []

    def throw(seed: int, pace_ratio: float = 0.25) -> list[ThrowResult]:
        return run_throws(
            Twin.for_plant(count=2, unit_seed=0),
            params(swing_policies),
            target_m,
            starts(target_m),
            seed,
            progress=lambda done, total: told.append((done, total)),
            pace_ratio=pace_ratio,
        )

    first = throw(1)
    assert [r.outcome for r in first] == [ThrowOutcome.LANDED] * 5
    assert [r.target_m[0] for r in first] == target_m[:, 0].tolist()
    done = [d for d, _ in told]
    assert done == sorted(done)
    assert told[-1] == (5, 5)
    for r in first:
        assert r.downrange_error_m == pytest.approx(
            np.hypot(*r.impact_m[:2]) - r.target_m[0], abs=2e-3
        )
        assert r.simulated_s > r.throw_duration_s > 0.5
        assert 1.0 < r.release_speed_m_per_s < 6.0
    # A policy that was not trained with a pace does not see it.
    assert throw(1, pace_ratio=1.0) == first
    other = throw(2)
    assert (
        max(
            abs(a.downrange_error_m - b.downrange_error_m)
            for a, b in zip(first, other, strict=True)
        )
        > 1e-3
    )


def test_a_load_can_land_on_a_raised_surface(swing_policies: Path) -> None:
    target_m = np.array([[6.0, 0.0, 0.0], [6.0, 0.0, 0.5]])
    twin = Twin.for_plant(count=2, unit_seed=0)
    low, high = run_throws(twin, params(swing_policies), target_m, starts(target_m), 0)
    assert high.outcome is ThrowOutcome.LANDED
    assert high.impact_m[2] == pytest.approx(0.5)
    assert high.downrange_error_m < low.downrange_error_m - 0.05


def test_a_start_in_the_ground_is_a_collision_and_a_policy_that_waits_no_release(
    swing_policies: Path,
) -> None:
    target_m = np.tile([[6.0, 0.0, 0.0]], (2, 1))
    poses = starts(target_m)
    poses[1, 1:4] = (0.0, 0.0, 1.2)
    poses[1, 4] = hanging_pitch_rad(poses[1, :4])
    twin = Twin.for_plant(count=2, unit_seed=0)
    waits, hits = run_throws(twin, params(swing_policies, "waits-2d"), target_m, poses, 0)
    assert hits.outcome is ThrowOutcome.COLLISION
    assert hits.simulated_s < 0.1
    assert waits.outcome is ThrowOutcome.NO_RELEASE
    assert waits.simulated_s == pytest.approx(7.0)
    for bad in (waits, hits):
        assert np.isnan([bad.downrange_error_m, bad.release_speed_m_per_s]).all()
        assert np.isnan(bad.impact_m).all()
    assert outcome_counts([waits, hits]) == {"no_release": 1, "collision": 1}


def test_predicting_the_flight_gives_the_impacts_that_flying_gives(swing_policies: Path) -> None:
    target_m = np.tile([[6.0, 0.0, 0.0]], (4, 1))

    def throw(ends_at_release: bool) -> list[ThrowResult]:
        twin = Twin.for_plant(count=4, unit_seed=0)
        return run_throws(
            twin,
            params(swing_policies),
            target_m,
            starts(target_m),
            0,
            ends_at_release=ends_at_release,
        )

    for flown, predicted in zip(throw(False), throw(True), strict=True):
        assert predicted.outcome is flown.outcome is ThrowOutcome.LANDED
        np.testing.assert_allclose(predicted.impact_m, flown.impact_m, atol=1e-3)
        assert predicted.simulated_s == pytest.approx(flown.simulated_s, abs=0.021)
        assert predicted.throw_duration_s == flown.throw_duration_s


def test_survey_error_is_in_the_score_unless_the_truth_is_asked_for(swing_policies: Path) -> None:
    nominal = nominal_profile(SPEC)
    profile = nominal.model_copy(
        update={"noise": nominal.noise.model_copy(update={"survey_sd_m": 0.3})}
    )
    target_m = np.array([[6.0, 0.0, 0.0]])

    def throw(use_truth: bool) -> ThrowResult:
        twin = Twin(count=1, profile=profile, calibration=CALIBRATION)
        return run_throws(
            twin, params(swing_policies), target_m, starts(target_m), 0, use_truth=use_truth
        )[0]

    surveyed, true = throw(False), throw(True)
    assert abs(surveyed.crossrange_error_m - true.crossrange_error_m) > 0.01


def test_what_cannot_be_thrown_is_refused_before_anything_moves(swing_policies: Path) -> None:
    twin = Twin.for_plant(count=1, unit_seed=0)
    target_m = np.array([[6.0, 0.0, 0.0]])
    no_policy = ControlParams(spec=SPEC, calibration=CALIBRATION, mode=Mode.PLANAR, policy=None)
    with pytest.raises(UsageError, match="needs a policy"):
        run_throws(twin, no_policy, target_m, starts(target_m), 0)
    with pytest.raises(UsageError, match="1 targets but 2 start poses"):
        run_throws(twin, params(swing_policies), target_m, np.zeros((2, 6)), 0)


@given(azimuth=st.floats(-3.1, 3.1), down=st.floats(-3.0, 3.0), cross=st.floats(-3.0, 3.0))
def test_errors_are_along_and_left_of_the_target_line(
    azimuth: float, down: float, cross: float
) -> None:
    along = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    left = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    errors = throw_errors((9.0 * along + down * along + cross * left)[None], 9.0 * along[None])
    np.testing.assert_allclose(np.ravel(errors), [down, cross], atol=1e-9)


def test_the_ellipse_is_that_of_the_landed_throws() -> None:
    rng = np.random.default_rng(0)
    down = 0.1 + 0.3 * rng.standard_normal(500)
    cross = -0.05 + 0.5 * down + 0.1 * rng.standard_normal(500)
    thrown = [result(float(d), float(c)) for d, c in zip(down, cross, strict=True)]
    ellipse = landing_ellipse([*thrown, result(9.0, 9.0, ThrowOutcome.COLLISION)])
    assert ellipse is not None
    assert (ellipse.rollout_count, ellipse.landed_count) == (501, 500)
    assert ellipse.mean_downrange_error_m == pytest.approx(down.mean())
    assert ellipse.sd_crossrange_m == pytest.approx(np.std(cross, ddof=1))
    assert ellipse.correlation_ratio == pytest.approx(np.corrcoef(down, cross)[0, 1])
    assert landing_ellipse(thrown[:1]) is None


def test_accuracy_rows_count_everything_and_average_what_landed() -> None:
    row = target_accuracy(
        9.0, [result(0.1, 0.0), result(0.3, -0.2), result(0, 0, ThrowOutcome.LIMIT)]
    )
    assert (row["throws"], row["landed"]) == (3, 2)
    assert row["success_ratio"] == pytest.approx(2 / 3)
    assert row["mean_downrange_error_m"] == pytest.approx(0.2)
    assert row["sd_crossrange_m"] == pytest.approx(np.std([0.0, -0.2], ddof=1))
    none = target_accuracy(9.0, [result(0, 0, ThrowOutcome.TIMEOUT)])
    assert none["mean_downrange_error_m"] is None
    one = target_accuracy(9.0, [result(0.1, 0.0)])
    assert (one["mean_downrange_error_m"], one["sd_downrange_m"]) == (pytest.approx(0.1), None)
    late = result(0, 0, ThrowOutcome.COLLISION)
    early = result(0, 0, ThrowOutcome.LIMIT)._replace(throw_duration_s=float("nan"))
    assert bad_throws_text([late, early, result(0, 0)]) == (
        "2 of 3 throws ended badly: 1 collision, 1 limit (1 after the opening command)"
    )
    assert bad_throws_text([result(0, 0)]) == ""
    table = accuracy_table(
        {
            "mode": "2d",
            "plant": "twin",
            "policy": "p",
            "seed": 0,
            "seconds": 2.0,
            "real_time_factor": 400.0,
            "targets": [row, none],
        }
    )
    assert "+0.200" in table
    assert "400 times faster" in table
