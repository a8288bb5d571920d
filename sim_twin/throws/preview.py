"""Preview of one throw in the twin: motion, landing, landing ellipse, refusals.

The nominal throw is reported first, the landing ellipse in parts afterwards. A preview never commands a
machine, and a plan made from it must still pass the machine's checks.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from machine.ballistics import step_flight
from machine.conventions import CONTROL_PERIOD_S, DEFAULT_PACE_RATIO, JOINT_COUNT, Array
from machine.errors import RefusedError, UsageError
from machine.messages import LandingEllipse, RejectReason, Target
from machine.reach import check_target
from machine.site.objects import SiteObject
from machine.site.zones import Zone
from runtime.control.control_loop import ControlParams
from sim_twin.throws.campaign import (
    ThrowBatch,
    ThrowOutcome,
    ThrowResult,
    landing_ellipse,
    run_throws,
    throw_errors,
)
from sim_twin.throws.clearances import Clearance, limit_clearances, solid_clearances
from sim_twin.throws.landing import SiteLanding
from sim_twin.throws.refusals import PreviewRefusal, nominal_refusals, spread_refusals
from sim_twin.throws.throw_start import scattered_starts, throw_start
from sim_twin.throws.zone_check import ZoneCheck
from sim_twin.twin.profile import TwinProfile, exact_profile
from sim_twin.twin.twin import Twin

FRAME_TICKS = 2
FRAME_PERIOD_S = FRAME_TICKS * CONTROL_PERIOD_S
FIRST_CHUNK_COUNT = 50
"""Throws of the first ellipse; the others then run side by side, which is fastest."""


@dataclass(frozen=True, slots=True)
class PreviewRequest:
    """A target and the present state of the machine."""

    params: ControlParams
    profile: TwinProfile
    target: Target
    joint_position_rad_m: tuple[float, float, float, float, float, float]
    """Present pose; the gripper is assumed plumb and loaded, its two entries are ignored."""
    site: tuple[SiteObject, ...] = ()
    """Objects around the machine."""
    zones: tuple[Zone, ...] = ()
    """Exclusion zones."""
    rollout_count: int = 200
    """Throws of the landing ellipse; 0 for none."""
    seed: int = 0
    pace_ratio: float = DEFAULT_PACE_RATIO
    """0 careful .. 1 fast."""


@dataclass(frozen=True, slots=True)
class ThrowPreview:
    """Predicted throw. Times from the first frame; frame `machine`; NaN for values that do not exist."""

    refused: tuple[PreviewRefusal, ...]
    impact_m: tuple[float, float, float] | None
    ellipse: LandingEllipse | None
    frames_rad_m: Array
    """(T, 6) joint positions every `frame_period_s`; a 2D throw begins with the turn of the cabin."""
    frame_period_s: float
    ball_path_m: Array
    """(M, 3) flight from release to impact: a point every `frame_period_s`, and the impact."""
    release_s: float
    flight_s: float
    duration_s: float
    release_speed_m_per_s: float
    lands_on: str | None
    """Name of the surface that the load touches first, ground or object; None without contact."""
    clearances: tuple[Clearance, ...]
    wall_s: float
    """Computing time so far."""
    is_final: bool
    """Whether motion up to the impact, ellipse and all refusals are complete."""


Progress = Callable[[ThrowPreview], None]


def preview(request: PreviewRequest, on_progress: Progress | None = None) -> ThrowPreview:
    """Predict a throw.

    Args:
        request: target, machine, policy, twin.
        on_progress: called at the release of the nominal throw (frames up to there, predicted impact and
            flight), at its landing, and after every part of the ellipse, with all results so far. An
            exception that it raises ends the preview.

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
        return _nothing(PreviewRefusal(error.reason, error.detail), perf_counter() - started)
    zones = ZoneCheck(request.zones, request.params.spec.ball.radius_m)
    unlikely = zones.target_refusal(request.target) or SiteLanding.of(
        request.site, request.target
    ).target_refusal(request.target)
    if unlikely is not None:
        return _nothing(unlikely, perf_counter() - started)
    nominal = _NominalThrow(request, zones, started)
    shown = nominal.run(on_progress)
    if request.rollout_count == 0 or shown.impact_m is None:
        return replace(shown, is_final=True, wall_s=perf_counter() - started)
    complete = _with_ellipse(request, nominal.start, shown, started, on_progress)
    return _held_against(zones, request.target, complete)


def _held_against(zones: ZoneCheck, target: Target, shown: ThrowPreview) -> ThrowPreview:
    """The preview with the refusals of its landing region, where its nominal flight is in no zone."""
    if any(refusal.reason is RejectReason.TARGET_IN_ZONE for refusal in shown.refused):
        return shown
    found = zones.flight_refusals(shown.ball_path_m, target, shown.impact_m, shown.ellipse)
    return replace(shown, refused=(*found, *shown.refused))


def _nothing(refusal: PreviewRefusal, wall_s: float) -> ThrowPreview:
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
        lands_on=None,
        clearances=(),
        wall_s=wall_s,
        is_final=True,
    )


def _point(target: Target) -> Array:
    return np.array([[target.x_m, target.y_m, target.z_m]])


class _NominalThrow:
    """The throw that is shown: the twin without random scatter."""

    def __init__(self, request: PreviewRequest, zones: ZoneCheck, started: float) -> None:
        params = request.params
        self._zones, self._request_target = zones, request.target
        self._spec, self._started = params.spec, started
        self._target = _point(request.target)
        self._landing = SiteLanding.of(request.site, request.target)
        pose = np.asarray(request.joint_position_rad_m)
        self.start, self._turn = throw_start(
            params.spec, params.mode, pose, self._target[0], FRAME_PERIOD_S
        )
        self._twin = Twin(
            count=1, profile=exact_profile(request.profile), calibration=params.calibration
        )
        self._twin.set_solids(self._landing.solids)
        self._batch = ThrowBatch(
            self._twin,
            params,
            self._target,
            self.start[None],
            request.seed,
            1,
            request.pace_ratio,
        )
        self._film = [self.start]
        self._solids: list[Clearance] = []
        self._solids_count = 0
        """Number of frames that the distances in `_solids` cover."""

    def run(self, on_progress: Progress | None) -> ThrowPreview:
        """Simulate the throw; report it at the release and at the landing."""
        self._roll(until_release=True)
        if self._twin.payload.flying[0]:
            predicted = self._shown(self._predicted_result())
            if on_progress is not None:
                on_progress(predicted)
        self._roll(until_release=False)
        shown = self._shown(self._batch.results()[0])
        if on_progress is not None:
            on_progress(shown)
        return shown

    def _roll(self, *, until_release: bool) -> None:
        batch, ticks = self._batch, 0
        while batch.running[0] and not (until_release and batch.load_gone[0]):
            batch.tick()
            ticks = round(batch.rollout.elapsed_s / CONTROL_PERIOD_S)
            if ticks % FRAME_TICKS == 0:
                self._film.append(self._twin.joint_position_rad_m[0])

    def _predicted_result(self) -> ThrowResult:
        """Result of a throw just released, assuming that nothing fails afterwards."""
        point = self._batch
        impact, flight_s = self._twin.predicted_impact()
        down, cross = throw_errors(impact, self._target)
        return ThrowResult(
            target_m=tuple(self._target[0].tolist()),
            outcome=ThrowOutcome.LANDED,
            impact_m=tuple(impact[0].tolist()),
            downrange_error_m=float(down[0]),
            crossrange_error_m=float(cross[0]),
            release_speed_m_per_s=float(point.release_speed_m_per_s[0]),
            throw_duration_s=float(point.release_s[0]),
            simulated_s=float(point.release_s[0] + flight_s[0]),
        )

    def _shown(self, result: ThrowResult) -> ThrowPreview:
        frames = np.concatenate([self._turn, np.stack(self._film)])
        landed = result.outcome is ThrowOutcome.LANDED
        thrown = frames.shape[0]
        if not np.isnan(result.throw_duration_s):
            thrown = self._turn.shape[0] + 1 + round(result.throw_duration_s / FRAME_PERIOD_S)
        self._solids = solid_clearances(
            frames, FRAME_PERIOD_S, self._solids, self._solids_count, self._landing.solids
        )
        self._solids_count = frames.shape[0]
        clearances = (
            *self._solids,
            # Limits matter up to the release only.
            *limit_clearances(self._spec, frames[:thrown], FRAME_PERIOD_S),
            *self._zones.clearances(frames, FRAME_PERIOD_S),
        )
        path = self._flight_path(result) if landed else np.zeros((0, 3))
        end = self._twin.payload.predicted if landed else None
        contact = None if end is None else end.contact
        impact_m = result.impact_m if landed else None
        return ThrowPreview(
            refused=self._zones.flight_refusals(path, self._request_target, impact_m)
            + self._landing.refusals(contact)
            + nominal_refusals(result, clearances),
            impact_m=impact_m,
            ellipse=None,
            frames_rad_m=frames,
            frame_period_s=FRAME_PERIOD_S,
            ball_path_m=path,
            release_s=self._turn.shape[0] * FRAME_PERIOD_S + result.throw_duration_s,
            flight_s=result.simulated_s - result.throw_duration_s if landed else float("nan"),
            duration_s=(frames.shape[0] - 1) * FRAME_PERIOD_S,
            release_speed_m_per_s=result.release_speed_m_per_s,
            lands_on=self._landing.met(contact),
            clearances=clearances,
            wall_s=perf_counter() - self._started,
            is_final=False,
        )

    def _flight_path(self, result: ThrowResult) -> Array:
        """Flight (M, 3) of the load's centre, ending at the impact."""
        load = self._twin.payload
        position, velocity = load.release_position_m, load.release_velocity_m_per_s
        points = [position[0]]
        flight_s = result.simulated_s - result.throw_duration_s
        for _ in range(int(flight_s / FRAME_PERIOD_S)):
            position, velocity = step_flight(
                position,
                velocity,
                load.drag_per_m,
                load.wind_m_per_s,
                FRAME_PERIOD_S,
                load.spin,
            )
            points.append(position[0])
        if load.predicted is not None:
            points.append(load.predicted.centre_m[0])
        return np.stack(points)


def _with_ellipse(
    request: PreviewRequest,
    start: Array,
    shown: ThrowPreview,
    started: float,
    on_progress: Progress | None,
) -> ThrowPreview:
    """Run the scattered throws in parts; report the ellipse of all throws so far after each."""
    total = request.rollout_count
    first = min(FIRST_CHUNK_COUNT, total)
    results: list[ThrowResult] = []
    astray: list[str] = []
    landing = SiteLanding.of(request.site, request.target)
    for number, size in enumerate((first, total - first) if total > first else (first,)):
        twin = Twin(count=size, profile=request.profile, calibration=request.params.calibration)
        twin.set_solids(landing.solids)
        rng = np.random.default_rng((request.seed, 2, number))
        starts = scattered_starts(request.params.spec, request.profile.spread, start, size, rng)
        target = np.repeat(_point(request.target), size, axis=0)
        seed = int(np.random.SeedSequence((request.seed, 1, number)).generate_state(1)[0])
        results.extend(
            run_throws(
                twin,
                request.params,
                target,
                starts,
                seed,
                ends_at_release=True,
                pace_ratio=request.pace_ratio,
            )
        )
        end = twin.payload.predicted
        astray += landing.wrong_contacts(None if end is None else end.contact)
        shown = replace(shown, ellipse=landing_ellipse(results), wall_s=perf_counter() - started)
        if on_progress is not None and len(results) < total:
            on_progress(shown)
    return replace(
        shown,
        refused=(*shown.refused, *spread_refusals(results, astray)),
        wall_s=perf_counter() - started,
        is_final=True,
    )
