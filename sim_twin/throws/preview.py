"""Preview of one throw in the twin: motion, landing, landing ellipse, refusals.

The nominal throw is reported first, the landing ellipse in parts afterwards. A preview never commands a
machine, and a plan made from it must still pass the machine's checks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter
from typing import NamedTuple

import numpy as np

from machine.ballistics import step_flight
from machine.conventions import CONTROL_PERIOD_S, DEFAULT_PACE_RATIO, JOINT_COUNT, Array
from machine.errors import RefusedError, UsageError
from machine.messages import LandingEllipse, RejectReason, Target
from machine.reach import check_target
from machine.site.objects import SiteObject
from machine.site.solids import Solids
from machine.site.zones import Zone
from runtime.control.control_loop import ControlOutputs, ControlParams
from runtime.driver import SensorSample, SimulatedDriver
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
    aim: Target | None = None
    """Point that the policy is given in place of the target, by an aim correction. The machine is expected to
    miss it by as much as it lies off the target; flights and landings of the twin are moved by that."""

    @property
    def aimed(self) -> Target:
        """The point that the policy is given."""
        return self.target if self.aim is None else self.aim

    @property
    def miss_m(self) -> Array:
        """Miss (3,) that the aim correction expects of the machine, frame `machine`."""
        return (_point(self.target) - _point(self.aimed))[0]

    def solids_of_flight(self, landing: SiteLanding) -> Solids:
        """The site as the twin's flights have to meet it: moved against the miss."""
        if self.aim is None:
            return landing.solids
        x_m, y_m, _ = self.miss_m.tolist()
        moved = [
            item.model_copy(update={"x_m": item.x_m - x_m, "y_m": item.y_m - y_m})
            for item in landing.solids.objects
        ]
        return Solids(moved, landing.solids.ground_m)


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
Check = Callable[[], None]


class ScatterPart(NamedTuple):
    """Some of the scattered throws of a preview: rows `first` to `end` (exclusive) of one of its draws."""

    draw: int
    first: int
    end: int
    thread_count: int
    """Threads of the physics."""


class ScatteredThrows(NamedTuple):
    """Results of one part."""

    results: list[ThrowResult]
    astray: list[str]
    """Descriptions of throws that landed on another surface, one per throw."""


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
    shown = nominal_throw(request, on_progress)
    if shown.is_final:
        return shown
    parts = scatter_parts(request.rollout_count)
    done: list[ScatteredThrows] = []
    for part in parts:
        done.append(scattered_throws(request, part))
        if on_progress is not None and len(done) < len(parts):
            on_progress(replace(with_scatter(shown, done), wall_s=perf_counter() - started))
    zones = _zone_check(request)
    return completed(shown, done, request.target, zones, perf_counter() - started)


def nominal_throw(
    request: PreviewRequest, on_progress: Progress | None = None, check: Check | None = None
) -> ThrowPreview:
    """The throw that is shown, without its ellipse; final where there will be none.

    Args:
        request: as for `preview`.
        on_progress: called at the release and at the landing.
        check: called in every control tick; an exception that it raises ends the throw.

    Raises:
        UsageError: as `preview`.
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
        check_target(policy.card, request.aimed)
    except RefusedError as error:
        return _nothing(PreviewRefusal(error.reason, error.detail), perf_counter() - started)
    zones = _zone_check(request)
    unlikely = zones.target_refusal(request.target) or SiteLanding.of(
        request.site, request.target
    ).target_refusal(request.target)
    if unlikely is not None:
        return _nothing(unlikely, perf_counter() - started)
    shown = _NominalThrow(request, zones, started, check).run(on_progress)
    has_ellipse = request.rollout_count > 0 and shown.impact_m is not None
    return replace(shown, is_final=not has_ellipse, wall_s=perf_counter() - started)


def scatter_parts(rollout_count: int, process_count: int = 1) -> tuple[ScatterPart, ...]:
    """The scattered throws in the parts in which they run: few for a first ellipse, then the others.

    Args:
        rollout_count: all throws.
        process_count: processes among which the others are divided. The results do not depend on it.
    """
    first = min(FIRST_CHUNK_COUNT, rollout_count)
    others = rollout_count - first
    # Beside other processes a second thread would take the time of the throw that is shown.
    threads = 2 if process_count == 1 else 1
    count = min(process_count, max(1, others // FIRST_CHUNK_COUNT))
    edges = [others * index // count for index in range(count + 1)] if others else []
    return (
        ScatterPart(0, 0, first, threads),
        *(ScatterPart(1, one, other, threads) for one, other in pairwise(edges)),
    )


def scattered_throws(
    request: PreviewRequest, part: ScatterPart, check: Check | None = None
) -> ScatteredThrows:
    """Simulate one part of the scattered throws up to their releases.

    Args:
        request: as for `preview`.
        part: of `scatter_parts`.
        check: called in every control tick; an exception that it raises ends the throws.
    """
    draw, first, end, thread_count = part
    size, params = end - first, request.params
    landing = SiteLanding.of(request.site, request.target)
    start, _ = _start(request)
    twin = Twin(
        count=size,
        profile=request.profile,
        calibration=params.calibration,
        thread_count=thread_count,
        first_row=first,
    )
    twin.set_solids(request.solids_of_flight(landing))
    rng = np.random.default_rng((request.seed, 2, draw))
    starts = scattered_starts(params.spec, request.profile.spread, start, end, rng)[first:]
    results = run_throws(
        twin,
        params,
        np.repeat(_point(request.aimed), size, axis=0),
        starts,
        int(np.random.SeedSequence((request.seed, 1, draw)).generate_state(1)[0]),
        ends_at_release=True,
        pace_ratio=request.pace_ratio,
        record=None if check is None else _EveryTick(check),
    )
    touched = twin.payload.predicted
    return ScatteredThrows(
        results, landing.wrong_contacts(None if touched is None else touched.contact)
    )


def with_scatter(shown: ThrowPreview, done: Sequence[ScatteredThrows]) -> ThrowPreview:
    """A nominal throw with the ellipse of the parts that are done."""
    return replace(shown, ellipse=landing_ellipse([r for part in done for r in part.results]))


def completed(
    shown: ThrowPreview,
    done: Sequence[ScatteredThrows],
    target: Target,
    zones: ZoneCheck,
    wall_s: float,
) -> ThrowPreview:
    """The whole preview: a nominal throw with all its scattered throws and the refusals of the spread.

    Args:
        shown: the nominal throw.
        done: all parts, in their order.
        target: of the request.
        zones: of the request.
        wall_s: computing time.
    """
    results = [result for part in done for result in part.results]
    astray = [text for part in done for text in part.astray]
    shown = with_scatter(shown, done)
    refused = (*shown.refused, *spread_refusals(results, astray))
    if not any(refusal.reason is RejectReason.TARGET_IN_ZONE for refusal in shown.refused):
        # The landing region counts where the nominal flight is in no zone.
        found = zones.flight_refusals(shown.ball_path_m, target, shown.impact_m, shown.ellipse)
        refused = (*found, *refused)
    return replace(shown, refused=refused, wall_s=wall_s, is_final=True)


def _zone_check(request: PreviewRequest) -> ZoneCheck:
    return ZoneCheck(request.zones, request.params.spec.ball.radius_m)


class _EveryTick:
    """Calls a check in every tick of a campaign."""

    def __init__(self, check: Check) -> None:
        self._check = check

    def begin(self, plant: SimulatedDriver, first_throw_count: int, throw_count: int) -> None:
        """Nothing is recorded."""

    def tick(self, now_ns: int, sample: SensorSample, outputs: ControlOutputs) -> None:
        """Call the check."""
        self._check()

    def end(self, results: Sequence[ThrowResult]) -> None:
        """Nothing is recorded."""


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


def _start(request: PreviewRequest) -> tuple[Array, Array]:
    """Pose (6,) in which the throw begins and the frames (T, 6) of the turn to it."""
    pose, params = np.asarray(request.joint_position_rad_m), request.params
    return throw_start(params.spec, params.mode, pose, _point(request.aimed)[0], FRAME_PERIOD_S)


class _NominalThrow:
    """The throw that is shown: the twin without random scatter."""

    def __init__(
        self, request: PreviewRequest, zones: ZoneCheck, started: float, check: Check | None
    ) -> None:
        params = request.params
        self._check = check
        self._zones, self._request_target = zones, request.target
        self._spec, self._started = params.spec, started
        self._target, self._miss_m = _point(request.aimed), request.miss_m
        self._landing = SiteLanding.of(request.site, request.target)
        start, self._turn = _start(request)
        self._twin = Twin(
            count=1, profile=exact_profile(request.profile), calibration=params.calibration
        )
        self._twin.set_solids(request.solids_of_flight(self._landing))
        self._batch = ThrowBatch(
            self._twin,
            params,
            self._target,
            start[None],
            request.seed,
            1,
            request.pace_ratio,
        )
        self._film = [start]
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
            if self._check is not None:
                self._check()
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
        if contact is not None:
            contact = contact._replace(point_m=contact.point_m + self._miss_m)
        impact_m = self._moved(result.impact_m) if landed else None
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
        # The miss grows from the release on.
        return np.stack(points) + np.linspace(0.0, 1.0, len(points))[:, None] * self._miss_m

    def _moved(self, impact_m: tuple[float, float, float]) -> tuple[float, float, float]:
        x_m, y_m, z_m = (np.array(impact_m) + self._miss_m).tolist()
        return x_m, y_m, z_m
