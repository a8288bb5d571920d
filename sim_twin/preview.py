"""Preview of one throw in the twin: what it looks like, where it lands, how far it scatters, why not.

The nominal throw comes first, the landing ellipse streams in afterwards. A preview never commands a
machine; a plan made from it must still pass the machine's own checks.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from machine.ballistics import step_flight
from machine.conventions import CONTROL_PERIOD_S, JOINT_COUNT, Array, Mode, wrap_angle_rad
from machine.errors import RefusedError, UsageError
from machine.kinematics import aligned_slew_rad, hanging_pitch_rad
from machine.messages import LandingEllipse, RejectReason, Target
from machine.reach import check_target
from machine.spec import MachineSpec
from runtime.control_loop import ControlOutputs, ControlParams
from runtime.driver import SensorSample, SimulatedDriver
from runtime.imu_estimator import swing_frequency_rad_per_s
from runtime.swing_control import ALIGN_SPEED_RAD_PER_S, turn_profile
from sim_twin.campaign import Outcome, ThrowResult, landing_ellipse, run_throws
from sim_twin.clearances import Clearance, limit_clearances, solid_clearances
from sim_twin.profile import TwinProfile, exact_profile
from sim_twin.twin import Twin

FRAME_TICKS = 2
FRAME_PERIOD_S = FRAME_TICKS * CONTROL_PERIOD_S
CHUNK_COUNT = 50
"""Throws of the ellipse that run side by side: large enough for speed, small enough to stream."""
MISS_LIMIT_M = 0.5
"""A nominal throw that lands farther from its target than this is refused."""
BAD_THROW_LIMIT_RATIO = 0.05
"""Share of the ellipse's throws that may end badly."""
ALIGNED_RAD = 0.01


@dataclass(frozen=True, slots=True)
class PreviewRequest:
    """One wish, and the machine as it stands."""

    params: ControlParams
    profile: TwinProfile
    target: Target
    joint_position_rad_m: tuple[float, float, float, float, float, float]
    """The machine's pose now; the gripper is taken as plumb, whatever its two entries say."""
    payload_held: bool = True
    rollout_count: int = 200
    """Throws of the landing ellipse; 0 for none."""
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a throw is refused; `detail` has the numbers and the remedy, for people."""

    reason: RejectReason
    detail: str


@dataclass(frozen=True, slots=True)
class ThrowPreview:
    """What a throw will do. Times from the first frame; frame `machine`; NaN where nothing came of it."""

    refused: tuple[Refusal, ...]
    impact_m: tuple[float, float, float] | None
    ellipse: LandingEllipse | None
    frames_rad_m: Array
    """(T, 6) joint positions, one every `frame_period_s`; a 2D throw begins with the cabin's turn."""
    frame_period_s: float
    ball_path_m: Array
    """(M, 3) flight from release to impact, one point every `frame_period_s` and the impact."""
    release_s: float
    flight_s: float
    duration_s: float
    release_speed_m_per_s: float
    clearances: tuple[Clearance, ...]
    wall_s: float
    """Time that the computation took so far."""


Progress = Callable[[ThrowPreview], None]


def preview(request: PreviewRequest, on_progress: Progress | None = None) -> ThrowPreview:
    """Predict a throw.

    Args:
        request: target, machine, policy, twin.
        on_progress: called with the nominal throw first, then after every part of the ellipse with all
            that is known so far; whatever it raises ends the preview.

    Raises:
        UsageError: no policy, a pose that is not finite, a negative number of throws.
    """
    started = perf_counter()
    policy = request.params.policy
    if policy is None:
        raise UsageError("a preview needs a policy: name one with --policy DIR or --policies DIR")
    if not np.isfinite(request.joint_position_rad_m).all() or request.rollout_count < 0:
        raise UsageError(
            f"a preview needs finite joint positions and 0 or more throws, got "
            f"{request.joint_position_rad_m} and {request.rollout_count}"
        )
    try:
        check_target(policy.card, request.target)
    except RefusedError as error:
        return _nothing(Refusal(error.reason, error.detail), perf_counter() - started)
    if not request.payload_held:
        refusal = Refusal(
            RejectReason.NO_PAYLOAD, "Refused: the gripper is empty. Take up a load first."
        )
        return _nothing(refusal, perf_counter() - started)
    start, turn = _start(request)
    shown = _nominal(request, start, turn, started)
    if on_progress is not None:
        on_progress(shown)
    if request.rollout_count == 0 or shown.impact_m is None:
        return shown
    return _with_ellipse(request, start, shown, started, on_progress)


def _nothing(refusal: Refusal, wall_s: float) -> ThrowPreview:
    nan = float("nan")
    return ThrowPreview(
        refused=(refusal,),
        impact_m=None,
        ellipse=None,
        frames_rad_m=np.zeros((0, JOINT_COUNT)),
        frame_period_s=FRAME_PERIOD_S,
        ball_path_m=np.zeros((0, 3)),
        release_s=nan,
        flight_s=nan,
        duration_s=0.0,
        release_speed_m_per_s=nan,
        clearances=(),
        wall_s=wall_s,
    )


def _point(target: Target) -> Array:
    return np.array([[target.x_m, target.y_m, target.z_m]])


def _start(request: PreviewRequest) -> tuple[Array, Array]:
    """Pose (6,) in which the throw begins, and the frames (T, 6) of the cabin's turn to it."""
    pose = np.asarray(request.joint_position_rad_m, dtype=np.float64).copy()
    pose[4], pose[5] = hanging_pitch_rad(pose[:4]), 0.0
    if request.params.mode is Mode.SPATIAL:
        return pose, np.zeros((0, JOINT_COUNT))
    spec = request.params.spec
    wanted = aligned_slew_rad(spec, _point(request.target))[0]
    distance = float(wrap_angle_rad(wanted - pose[0]))
    aligned = pose.copy()
    aligned[0] += distance
    if abs(distance) < ALIGNED_RAD:
        return aligned, np.zeros((0, JOINT_COUNT))
    slew = pose[0] + turn_angles_rad(spec, distance)
    frames = np.repeat(pose[None], slew.size, axis=0)
    frames[:, 0] = slew
    return aligned, frames


def turn_angles_rad(spec: MachineSpec, turn_rad: float) -> Array:
    """Angles (T,) of the turn that ALIGN plans, one a frame, from 0 to `turn_rad`.

    The turn before a 2D throw is drawn, not simulated: it ends at rest, and the throw is then simulated.
    """
    ramp_s = turn_ramp_s(spec)
    total_s = ramp_s + abs(turn_rad) / ALIGN_SPEED_RAD_PER_S
    time_s = np.arange(0.0, total_s, FRAME_PERIOD_S)
    return turn_profile(time_s, np.full(time_s.size, turn_rad), ramp_s)[0]


def turn_ramp_s(spec: MachineSpec) -> float:
    """Ramp of the planned turn: one swing period, the mean of both axes."""
    return 2.0 * math.pi / (0.5 * sum(swing_frequency_rad_per_s(spec)))


class _Frames:
    """Takes down the joint positions of a single twin machine at the frame rate."""

    def __init__(self, twin: Twin) -> None:
        self._twin, self._ticks = twin, 0
        self.frames: list[Array] = []

    def begin(self, plant: SimulatedDriver, first_throw_count: int, throw_count: int) -> None:
        """The start pose is the first frame."""
        self.frames.append(self._twin.joint_position_rad_m[0])

    def tick(self, now_ns: int, sample: SensorSample, outputs: ControlOutputs) -> None:
        """Every second tick is a frame."""
        self._ticks += 1
        if self._ticks % FRAME_TICKS == 0:
            self.frames.append(self._twin.joint_position_rad_m[0])

    def end(self, results: Sequence[ThrowResult]) -> None:
        """Nothing to close."""


def _nominal(request: PreviewRequest, start: Array, turn: Array, started: float) -> ThrowPreview:
    params = request.params
    twin = Twin(
        count=1,
        profile=exact_profile(request.profile),
        calibration=params.calibration,
        tracker=False,
    )
    film = _Frames(twin)
    target = _point(request.target)
    result = run_throws(twin, params, target, start[None], request.seed, record=film)[0]
    frames = np.concatenate([turn, np.stack(film.frames)])
    turn_s = turn.shape[0] * FRAME_PERIOD_S
    load = twin.payload
    landed = result.outcome is Outcome.LANDED
    flight_s = (load.impact_t_ns[0] - load.release_t_ns[0]) * 1e-9 if landed else float("nan")
    path = _flight_path(twin, flight_s) if landed else np.zeros((0, 3))
    # After the release the arm may come near a limit on its way back; the throw itself is what counts.
    thrown = frames[: turn.shape[0] + 1 + _frame_count(result.throw_duration_s, len(film.frames))]
    clearances = (
        *solid_clearances(frames, FRAME_PERIOD_S),
        *limit_clearances(params.spec, thrown, FRAME_PERIOD_S),
    )
    return ThrowPreview(
        refused=_refusals(result, clearances, request),
        impact_m=result.impact_m if landed else None,
        ellipse=None,
        frames_rad_m=frames,
        frame_period_s=FRAME_PERIOD_S,
        ball_path_m=path,
        release_s=turn_s + result.throw_duration_s,
        flight_s=flight_s,
        duration_s=(frames.shape[0] - 1) * FRAME_PERIOD_S,
        release_speed_m_per_s=result.release_speed_m_per_s,
        clearances=clearances,
        wall_s=perf_counter() - started,
    )


def _frame_count(duration_s: float, available_count: int) -> int:
    if math.isnan(duration_s):
        return available_count
    return min(round(duration_s / FRAME_PERIOD_S), available_count)


def _flight_path(twin: Twin, flight_s: float) -> Array:
    """Flight (M, 3) of the single machine's load, ending at the impact."""
    load = twin.payload
    position, velocity = load.release_position_m[:1], load.release_velocity_m_per_s[:1]
    points = [position[0]]
    for _ in range(int(flight_s / FRAME_PERIOD_S)):
        position, velocity = step_flight(
            position, velocity, load.drag_per_m[:1], load.wind_m_per_s, FRAME_PERIOD_S
        )
        points.append(position[0])
    points.append(load.impact_m[0] + np.array([0.0, 0.0, twin.spec.ball.radius_m]))
    return np.stack(points)


def _refusals(
    result: ThrowResult, clearances: Sequence[Clearance], request: PreviewRequest
) -> tuple[Refusal, ...]:
    texts: list[str] = [
        f"{c.name}: {c.value_rad_m:.2f} predicted {c.at_s:.1f} s after the start, at least "
        f"{c.limit_rad_m:.2f} needed. Start from another arm pose or choose another target."
        for c in clearances
        if c.value_rad_m < c.limit_rad_m
    ]
    if result.outcome is Outcome.LANDED:
        miss_m = math.hypot(result.downrange_error_m, result.crossrange_error_m)
        if miss_m > MISS_LIMIT_M:
            texts.append(
                f"predicted miss {miss_m:.2f} m ({result.downrange_error_m:+.2f} m downrange, "
                f"{result.crossrange_error_m:+.2f} m crossrange), at most {MISS_LIMIT_M:.2f} m allowed. "
                "Start from another arm pose, or use another policy version."
            )
    elif result.outcome is Outcome.NO_RELEASE:
        texts.append(
            f"the policy does not release within {result.simulated_s:.1f} s from this pose. "
            "Move the arm to the safe pose and preview again."
        )
    elif result.outcome is Outcome.TIMEOUT:
        texts.append("the load never comes down. Check the target's height.")
    elif not texts:
        what = (
            "touches ground or machine" if result.outcome is Outcome.COLLISION else "meets a limit"
        )
        texts.append(
            f"the machine {what} {result.simulated_s:.1f} s after the start of the throw. "
            "Start from another arm pose or choose another target."
        )
    return tuple(Refusal(RejectReason.PREVIEW_REFUSED, f"Refused: {text}") for text in texts)


def _with_ellipse(
    request: PreviewRequest,
    start: Array,
    shown: ThrowPreview,
    started: float,
    on_progress: Progress | None,
) -> ThrowPreview:
    """Run the scattered throws part by part, and report the ellipse of all so far after each."""
    total = request.rollout_count
    chunk = min(CHUNK_COUNT, total)
    twin = Twin(
        count=chunk, profile=request.profile, calibration=request.params.calibration, tracker=False
    )
    results: list[ThrowResult] = []
    preview_so_far = shown
    for number, first in enumerate(range(0, total, chunk)):
        size = min(chunk, total - first)
        starts = _scattered_starts(request, start, size, number)
        target = np.repeat(_point(request.target), size, axis=0)
        seed = int(np.random.SeedSequence((request.seed, 1, number)).generate_state(1)[0])
        results.extend(run_throws(twin, request.params, target, starts, seed))
        preview_so_far = replace(
            shown, ellipse=landing_ellipse(results), wall_s=perf_counter() - started
        )
        if on_progress is not None and len(results) < total:
            on_progress(preview_so_far)
    return replace(
        preview_so_far,
        refused=(*shown.refused, *_spread_refusals(results)),
        wall_s=perf_counter() - started,
    )


def _scattered_starts(request: PreviewRequest, start: Array, count: int, number: int) -> Array:
    spread = request.profile.spread
    sd = np.array([*spread.start_position_sd_rad_m, *spread.start_swing_sd_rad])
    rng = np.random.default_rng((request.seed, 2, number))
    poses = start + rng.standard_normal((count, JOINT_COUNT)) * sd
    # The gripper hangs from the arm as it really stands.
    poses[:, 4] += hanging_pitch_rad(poses[:, :4]) - start[4]
    low, high = request.params.spec.position_range_rad_m
    poses[:, :4] = np.clip(poses[:, :4], low, high)
    return poses


def _spread_refusals(results: Sequence[ThrowResult]) -> tuple[Refusal, ...]:
    bad = [r.outcome.value for r in results if r.outcome is not Outcome.LANDED]
    if len(bad) <= BAD_THROW_LIMIT_RATIO * len(results):
        return ()
    kinds = ", ".join(f"{bad.count(kind)} {kind.replace('_', ' ')}" for kind in sorted(set(bad)))
    return (
        Refusal(
            RejectReason.PREVIEW_REFUSED,
            f"Refused: {len(bad)} of {len(results)} predicted throws end badly ({kinds}), at most "
            f"{BAD_THROW_LIMIT_RATIO:.0%} allowed. Start from another arm pose or choose another target.",
        ),
    )
