from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine.calibration import nominal_calibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.kinematics import aligned_slew_rad, grip_centre, hanging_pitch_rad
from machine.messages import RejectReason, Target
from machine.site.objects import SiteKind, SiteObject
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner
from sim_twin.effects.effect import Effect
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult
from sim_twin.throws.clearances import Clearance, limit_clearances, solid_clearances
from sim_twin.throws.preview import (
    PreviewRequest,
    ThrowPreview,
    nominal_throw,
    preview,
    scatter_parts,
    scattered_throws,
)
from sim_twin.throws.refusals import nominal_refusals, spread_refusals
from sim_twin.throws.throw_start import scattered_starts, throw_start, turn_angles_rad
from sim_twin.twin.profile import Spread, nominal_profile
from tests.cases import each

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
SAFE = safe_pose()


def request(
    folder: Path, name: str = "swing-2d", target: Target | None = None, rollouts: int = 0
) -> PreviewRequest:
    runner = PolicyRunner(folder / name, SPEC)
    params = ControlParams(spec=SPEC, calibration=CALIBRATION, mode=runner.card.mode, policy=runner)
    pose = safe_pose(0.4)
    return PreviewRequest(
        params=params,
        profile=nominal_profile(SPEC),
        target=target or Target(x_m=6.0, y_m=0.0),
        joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], 9.0, 9.0),
        rollout_count=rollouts,
    )


@pytest.fixture(scope="module")
def streamed(swing_policies: Path) -> list[ThrowPreview]:
    """Everything that a preview with an ellipse of 70 throws reports, the answer last."""
    shown: list[ThrowPreview] = []
    shown.append(preview(request(swing_policies, rollouts=70), shown.append))
    return shown


def test_the_nominal_throw_streams_first_and_the_ellipse_grows(
    streamed: list[ThrowPreview],
) -> None:
    counts = [0 if p.ellipse is None else p.ellipse.rollout_count for p in streamed]
    assert counts[0] == counts[1] == 0
    assert counts == sorted(counts)
    assert counts[-1] == 70
    assert len(set(counts)) >= 3
    assert [p.is_final for p in streamed] == [False] * (len(streamed) - 1) + [True]
    walls = [p.wall_s for p in streamed]
    assert walls == sorted(walls)


def test_what_is_told_at_the_release_is_what_happens(streamed: list[ThrowPreview]) -> None:
    first, last = streamed[0], streamed[-1]
    assert first.impact_m is not None
    assert last.impact_m is not None
    np.testing.assert_allclose(first.impact_m, last.impact_m, atol=2e-3)
    assert first.release_s == last.release_s
    assert first.flight_s == pytest.approx(last.flight_s, abs=0.011)
    count = first.frames_rad_m.shape[0]
    assert count < last.frames_rad_m.shape[0]
    np.testing.assert_array_equal(first.frames_rad_m, last.frames_rad_m[:count])


def test_a_good_throw_is_not_refused_and_its_ellipse_lies_about_the_impact(
    streamed: list[ThrowPreview],
) -> None:
    last = streamed[-1]
    assert last.refused == ()
    assert last.ellipse is not None
    assert last.impact_m is not None
    nominal_error = np.hypot(last.impact_m[0], last.impact_m[1]) - 6.0
    assert last.ellipse.mean_downrange_error_m == pytest.approx(nominal_error, abs=0.05)
    assert 0.002 < last.ellipse.sd_downrange_m < 0.3


def test_frames_run_from_the_machines_pose_through_the_turn_to_the_impact(
    streamed: list[ThrowPreview],
) -> None:
    last = streamed[-1]
    frames = last.frames_rad_m
    np.testing.assert_allclose(frames[0, :4], [0.4, *SAFE[1:4]], atol=1e-9)
    assert frames[0, 4] == pytest.approx(hanging_pitch_rad(SAFE[:4]))
    assert np.abs(np.diff(frames[:, :4], axis=0)).max() < 0.03, "no jump between turn and throw"
    release = round(last.release_s / last.frame_period_s)
    aligned = aligned_slew_rad(SPEC, np.array([[6.0, 0.0, 0.0]]))[0]
    assert frames[release, 0] == pytest.approx(aligned, abs=0.02)
    assert last.duration_s == pytest.approx((len(frames) - 1) * last.frame_period_s)
    assert last.duration_s == pytest.approx(last.release_s + last.flight_s, abs=0.05)


def test_the_ball_leaves_the_gripper_and_ends_at_the_impact(streamed: list[ThrowPreview]) -> None:
    last = streamed[-1]
    path = last.ball_path_m
    release = round(last.release_s / last.frame_period_s)
    grip = grip_centre(SPEC, last.frames_rad_m[release], np.zeros(6)).position_m
    assert np.linalg.norm(path[0] - grip) < 0.06
    assert last.impact_m is not None
    np.testing.assert_allclose(path[-1] - [0, 0, SPEC.ball.radius_m], last.impact_m, atol=1e-9)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    assert steps.max() < last.frame_period_s * 10.0
    assert len(path) == pytest.approx(last.flight_s / last.frame_period_s, abs=2)


def test_clearances_name_ground_machine_and_limits(streamed: list[ThrowPreview]) -> None:
    found = {c.name: c for c in streamed[-1].clearances}
    assert {"gripper to ground", "gripper to cabin", "boom to its limit"} <= set(found)
    assert 0.3 < found["gripper to ground"].value_rad_m < 2.0
    assert all(c.value_rad_m >= c.limit_rad_m for c in found.values())
    assert all(0.0 <= c.at_s <= streamed[-1].duration_s for c in found.values())


def test_the_same_wish_gives_the_same_preview(swing_policies: Path) -> None:
    one, two = (preview(request(swing_policies, rollouts=8)) for _ in range(2))
    assert one.impact_m == two.impact_m
    assert one.ellipse == two.ellipse


@each(
    ("name", "impact_m", "ellipse", "refusal_count"),
    [
        ("swing-2d", (6.02817, 0.00132), (0.01753, 0.00024, 0.08645, 0.01044, 0.40113), 0),
        ("swing-3d", (5.96648, 0.82857), (-0.04116, 0.83602, 0.08665, 0.08900, -0.67561), 1),
    ],
)
def test_a_seed_gives_the_same_numbers_for_ever(
    swing_policies: Path,
    name: str,
    impact_m: tuple[float, ...],
    ellipse: tuple[float, ...],
    refusal_count: int,
) -> None:
    """Speed is no reason for other numbers: mean and spread along and across, correlation."""
    shown = preview(request(swing_policies, name, rollouts=120))
    assert shown.impact_m is not None
    assert shown.ellipse is not None
    found = shown.ellipse
    assert shown.impact_m[:2] == pytest.approx(impact_m, abs=1e-4)
    assert (
        found.mean_downrange_error_m,
        found.mean_crossrange_error_m,
        found.sd_downrange_m,
        found.sd_crossrange_m,
        found.correlation_ratio,
    ) == pytest.approx(ellipse, abs=1e-3)
    assert (found.landed_count, len(shown.refused)) == (120, refusal_count)


def test_throws_do_not_depend_on_the_parts_in_which_they_run(swing_policies: Path) -> None:
    wish = request(swing_policies, rollouts=150)
    whole, split = scatter_parts(150), scatter_parts(150, process_count=2)
    assert [(p.draw, p.first, p.end) for p in split] == [(0, 0, 50), (1, 0, 50), (1, 50, 100)]
    one = [r for part in whole[1:] for r in scattered_throws(wish, part).results]
    two = [r for part in split[1:] for r in scattered_throws(wish, part).results]
    assert [r.outcome for r in one] == [r.outcome for r in two]
    np.testing.assert_allclose([r.impact_m for r in one], [r.impact_m for r in two], atol=1e-6)
    assert len({r.impact_m for r in two}) == 100


class _EnoughError(Exception):
    pass


def test_a_preview_that_nobody_waits_for_ends_at_its_next_tick(swing_policies: Path) -> None:
    wish = request(swing_policies, rollouts=50)
    ticks = 0

    def check() -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 5:
            raise _EnoughError

    for simulate in (
        lambda: nominal_throw(wish, check=check),
        lambda: scattered_throws(wish, scatter_parts(50)[0], check),
    ):
        ticks = 0
        with pytest.raises(_EnoughError):
            simulate()
        assert ticks == 5


def test_what_a_diagnosis_found_acts_in_the_preview(swing_policies: Path) -> None:
    plain = request(swing_policies, rollouts=20)
    found = (
        Effect(effect="release_spin", parameters={"spin_rad_per_s": 20.0}),
        Effect(effect="base_yaw_drift", parameters={"yaw_rad": 0.1}),
        Effect(effect="release_delay", parameters={"extra_delay_s": 0.03}),
        Effect(effect="chassis_compliance", parameters={"pitch_rad": 0.02}),
    )
    profile = plain.profile.model_copy(update={"effects": found})
    shown: list[ThrowPreview] = []
    shown.append(preview(replace(plain, profile=profile), shown.append))
    before, after = preview(plain), shown[-1]
    assert before.impact_m is not None
    assert after.impact_m is not None
    assert before.ellipse is not None
    assert after.ellipse is not None
    np.testing.assert_allclose(shown[0].impact_m, after.impact_m, atol=2e-3)
    moved = after.impact_m[1] - before.impact_m[1]
    assert moved == pytest.approx(0.1 * before.impact_m[0], rel=0.15)
    shift = after.ellipse.mean_crossrange_error_m - before.ellipse.mean_crossrange_error_m
    assert shift == pytest.approx(moved, abs=0.1)
    # The drawn flight ends where the load comes down, spin and all.
    step = np.linalg.norm(after.ball_path_m[-2] - after.ball_path_m[-3])
    assert np.linalg.norm(after.ball_path_m[-1] - after.ball_path_m[-2]) < 1.1 * step


def test_3d_starts_where_the_machine_stands(swing_policies: Path) -> None:
    shown = preview(request(swing_policies, "swing-3d"))
    assert shown.frames_rad_m[0, 0] == 0.4
    assert shown.is_final


def test_a_corrected_aim_moves_the_motion_and_not_the_landing(swing_policies: Path) -> None:
    target, aim = Target(x_m=6.2, y_m=0.0), Target(x_m=5.6, y_m=0.1)
    plain = preview(request(swing_policies, target=aim, rollouts=4))
    asked = replace(request(swing_policies, target=target, rollouts=4), aim=aim)
    found = preview(asked)
    assert found.impact_m is not None
    np.testing.assert_array_equal(found.frames_rad_m, plain.frames_rad_m)
    np.testing.assert_allclose(found.impact_m, np.add(plain.impact_m, (0.6, -0.1, 0.0)))
    np.testing.assert_array_equal(found.ball_path_m[0], plain.ball_path_m[0])
    np.testing.assert_allclose(found.ball_path_m[-1], plain.ball_path_m[-1] + (0.6, -0.1, 0.0))
    assert found.ellipse == plain.ellipse
    # What stands at the target is met there, not at the point aimed at.
    x_m, y_m, _ = found.impact_m
    box = SiteObject(
        name="lid", kind=SiteKind.BOX, x_m=x_m, y_m=y_m, length_m=0.4, width_m=0.4, height_m=0.1
    )
    on_box = replace(asked, target=Target(x_m=x_m, y_m=y_m, z_m=0.1), site=(box,))
    on_box = replace(on_box, aim=Target(x_m=x_m - 0.6, y_m=y_m + 0.1, z_m=0.1), rollout_count=0)
    assert preview(on_box).lands_on == "lid"
    beside = Target(x_m=x_m - 0.6, y_m=y_m + 0.1)
    assert preview(replace(on_box, aim=None, target=beside)).lands_on == "ground"


@each(
    ("target", "reason", "words"),
    [
        (Target(x_m=20.0, y_m=0.0), RejectReason.TARGET_OUT_OF_REACH, "20.00 m"),
        (Target(x_m=2.0, y_m=1.0), RejectReason.TARGET_TOO_NEAR, "5.50 m"),
        (Target(x_m=7.0, y_m=0.0, z_m=2.0), RejectReason.TARGET_OUT_OF_REACH, "+2.00 m"),
    ],
)
def test_targets_outside_the_policy_are_refused_without_a_rollout(
    swing_policies: Path, target: Target, reason: RejectReason, words: str
) -> None:
    shown = preview(request(swing_policies, target=target, rollouts=50))
    assert [r.reason for r in shown.refused] == [reason]
    assert words in shown.refused[0].detail
    assert shown.impact_m is None
    assert shown.ellipse is None
    assert len(shown.frames_rad_m) == 0
    assert shown.is_final


def test_a_predicted_miss_is_refused_with_its_size(swing_policies: Path) -> None:
    shown = preview(request(swing_policies, target=Target(x_m=9.0, y_m=0.0)))
    assert [r.reason for r in shown.refused] == [RejectReason.PREVIEW_REFUSED]
    assert (
        "predicted miss 2." in shown.refused[0].detail
        or "predicted miss 3." in shown.refused[0].detail
    )
    assert shown.impact_m is not None, "the operator sees where it would go"


def test_a_policy_that_never_releases_is_refused(swing_policies: Path) -> None:
    shown = preview(request(swing_policies, "waits-2d", rollouts=50))
    assert "does not release within 7.0 s" in shown.refused[0].detail
    assert shown.impact_m is None
    assert shown.ellipse is None, "no ellipse of throws that do not exist"
    assert shown.is_final


def test_a_start_in_the_ground_is_refused_as_a_collision(swing_policies: Path) -> None:
    wish = request(swing_policies)
    low = replace(wish, joint_position_rad_m=(0.0, 0.0, 0.0, 1.2, 0.0, 0.0))
    shown = preview(low)
    assert any("gripper to ground -" in r.detail for r in shown.refused)


def test_an_error_of_the_listener_ends_the_preview(swing_policies: Path) -> None:
    class CancelledError(Exception):
        pass

    def cancel(_: ThrowPreview) -> None:
        raise CancelledError

    with pytest.raises(CancelledError):
        preview(request(swing_policies, rollouts=50), cancel)


def test_wishes_that_are_no_wishes(swing_policies: Path) -> None:
    wish = request(swing_policies)
    with pytest.raises(UsageError, match="needs a policy"):
        preview(replace(wish, params=replace(wish.params, policy=None)))
    with pytest.raises(UsageError, match="finite joint positions"):
        preview(replace(wish, joint_position_rad_m=(float("nan"), 0, 0, 0, 0, 0)))
    with pytest.raises(UsageError, match="0 or more throws"):
        preview(replace(wish, rollout_count=-1))


def test_refusals_of_scattered_throws_count_the_bad_ones() -> None:
    nan = float("nan")

    def thrown(outcome: ThrowOutcome) -> ThrowResult:
        return ThrowResult((9, 0, 0), outcome, (nan,) * 3, nan, nan, nan, nan, 2.0)

    good, bad = thrown(ThrowOutcome.LANDED), thrown(ThrowOutcome.COLLISION)
    assert spread_refusals([good] * 95 + [bad] * 5) == ()
    refused = spread_refusals([good] * 93 + [bad] * 5 + [thrown(ThrowOutcome.NO_RELEASE)] * 2)
    assert "7 of 100 predicted throws end badly (5 collision, 2 no release)" in refused[0].detail
    clear = Clearance("gripper to ground", 0.4, 0.0, 1.0, "m")
    assert "touches ground or machine" in nominal_refusals(bad, [clear])[0].detail
    near = clear._replace(value_rad_m=-0.1)
    assert [r.detail.count("touches") for r in nominal_refusals(bad, [near])] == [0]


def test_clearance_of_a_hanging_gripper_is_its_height_over_ground() -> None:
    claws = grip_centre(SPEC, SAFE, np.zeros(6)).position_m[2] + 1.0 - 0.85 - 0.40
    found = {c.name: c.value_rad_m for c in solid_clearances(SAFE[None], 0.02)}
    assert found["gripper to ground"] == pytest.approx(claws, abs=1e-6)
    limits = {c.name: c for c in limit_clearances(SPEC, np.stack([SAFE, SAFE]), 0.02)}
    assert limits["boom to its limit"].value_rad_m == pytest.approx(1.28 - 0.80)
    assert limits["telescope to its limit"].unit == "m"
    assert "slew to its limit" not in limits


@each("turn", [-3.0, -0.2, 0.05, 2.0])
def test_the_drawn_turn_is_smooth_and_arrives(turn: float) -> None:
    angles = turn_angles_rad(SPEC, turn, 0.02)
    assert angles[0] == 0.0
    assert angles[-1] == pytest.approx(turn, abs=0.002)
    assert np.abs(np.diff(angles)).max() <= 0.45 * 0.02 + 1e-9
    assert (np.diff(angles) * np.sign(turn) >= -1e-12).all()


def test_the_turn_takes_the_short_way() -> None:
    pose = safe_pose(3.0)
    start, frames = throw_start(SPEC, Mode.PLANAR, pose, np.array([-8.0, -0.5, 0.0]), 0.02)
    assert abs(start[0] - 3.0) < 0.5
    assert len(frames) > 0


def test_scattered_starts_have_their_spread_and_hang_plumb() -> None:
    spread = Spread(start_swing_sd_rad=(0.0, 0.0), start_position_sd_rad_m=(0.01, 0.02, 0.03, 0.04))
    poses = scattered_starts(SPEC, spread, SAFE, 4000, np.random.default_rng(0))
    np.testing.assert_allclose(poses[:, :4].std(axis=0), [0.01, 0.02, 0.03, 0.04], rtol=0.05)
    np.testing.assert_allclose(poses[:, 4], hanging_pitch_rad(poses[:, :4]))
    _, high = SPEC.position_range_rad_m
    edge = SAFE.copy()
    edge[3] = high[3]
    assert scattered_starts(SPEC, spread, edge, 50, np.random.default_rng(0))[:, 3].max() <= high[3]
