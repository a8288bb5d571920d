"""Campaigns of throws on one plant and their outcomes: the evaluation protocol of the paper (section IV-A).

The plant is the twin, the virtual machine or another `SimulatedDriver`. Only its sensor samples and its
survey of impacts are used.
"""

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, DEFAULT_PACE_RATIO, Array, BoolArray, Motion
from machine.errors import UsageError
from machine.kinematics import grip_centre, to_throw_frame
from machine.messages import LandingEllipse
from runtime.control.control_loop import ControlOutputs, ControlParams, Violation
from runtime.driver import SensorSample, SimulatedDriver
from sim_twin.throws.plant_abilities import Freezable, HasSurface, KnowsTruth, PredictsImpact
from sim_twin.throws.rollout import Rollout

RELEASE_TIMEOUT_S = 7.0
"""Time after which a throw without a release has failed, as in training."""
END_TIMEOUT_S = 14.0
"""Time after which a throw without an impact has failed."""
LIMIT_REACHED_RAD_M = 0.004
"""Distance from a position limit within which it counts as reached: four times the position noise."""

# Plain integers, because access to members of an enumeration is slow and happens in every tick.
_THROW = int(Motion.THROW)
_BEYOND = int(Violation.SWING | Violation.SAFETY)
_ABORTED = int(Violation.IMU | Violation.POLICY)


class ThrowOutcome(StrEnum):
    """How a throw ended."""

    LANDED = "landed"
    NO_RELEASE = "no_release"
    COLLISION = "collision"
    LIMIT = "limit"
    TIMEOUT = "timeout"


class ThrowResult(NamedTuple):
    """Result of one throw; NaN for missing values. `impact_m` in frame `machine`, errors in `throw`."""

    target_m: tuple[float, float, float]
    outcome: ThrowOutcome
    impact_m: tuple[float, float, float]
    downrange_error_m: float
    crossrange_error_m: float
    release_speed_m_per_s: float
    throw_duration_s: float
    """From the start of the throw to the release."""
    simulated_s: float
    """From the start of the throw to its end."""


class TickRecorder(Protocol):
    """Recorder of the ticks of a campaign (sim_twin.throws.throw_logs)."""

    def begin(self, plant: SimulatedDriver, first_throw_count: int, throw_count: int) -> None:
        """Start a batch whose machines carry out these throws."""
        ...

    def tick(self, now_ns: int, sample: SensorSample, outputs: ControlOutputs) -> None:
        """Record one control tick of the batch; `sample` is read after it."""
        ...

    def end(self, results: Sequence[ThrowResult]) -> None:
        """End the batch."""
        ...


Progress = Callable[[int, int], None]
"""Called with the numbers of ended throws and of all throws."""


def run_throws(
    plant: SimulatedDriver,
    params: ControlParams,
    targets_m: Array,
    starts_rad_m: Array,
    seed: int,
    *,
    record: TickRecorder | None = None,
    progress: Progress | None = None,
    use_truth: bool = False,
    ends_at_release: bool = False,
    pace_ratio: float = DEFAULT_PACE_RATIO,
    first_batch: int = 0,
) -> list[ThrowResult]:
    """Throw once at each target (N, 3) from each start (N, 6), `plant.count` at a time.

    Args:
        plant: machines.
        params: policy, calibration and spec of the control step.
        targets_m: frame `machine`.
        starts_rad_m: joint order.
        seed: seed of the plant's random numbers.
        record: recorder of every tick.
        progress: called when throws have ended.
        use_truth: score true impacts instead of surveyed ones, if the plant provides them.
        ends_at_release: end a throw at its release and score the predicted impact, if the plant predicts
            impacts. Collisions after the release are not detected then.
        pace_ratio: pace of every throw, 0 careful .. 1 fast.
        first_batch: number of the first batch, for a campaign that is run in parts.

    Raises:
        UsageError: no policy, unequal numbers of targets and starts, or a target off ground level on a
            plant without adjustable surface height.
    """
    if params.policy is None:
        raise UsageError("a campaign needs a policy: name one with --policy DIR or --policies DIR")
    count = targets_m.shape[0]
    if starts_rad_m.shape[0] != count:
        raise UsageError(f"{count} targets but {starts_rad_m.shape[0]} start poses")
    if np.any(targets_m[:, 2] != 0.0) and not isinstance(plant, HasSurface):
        raise UsageError(f"{type(plant).__name__} has ground only: targets need a height of 0 m")
    results: list[ThrowResult] = []
    for number, first in enumerate(range(0, count, plant.count)):
        taken = min(plant.count, count - first)
        # The last batch is filled with repetitions, whose results are dropped.
        rows = first + np.arange(plant.count) % taken
        batch_seed = int(np.random.SeedSequence((seed, first_batch + number)).generate_state(1)[0])
        batch = ThrowBatch(
            plant, params, targets_m[rows], starts_rad_m[rows], batch_seed, taken, pace_ratio
        )
        batch.use_truth = use_truth
        batch.ends_at_release = ends_at_release and isinstance(plant, PredictsImpact)
        if record is not None:
            record.begin(plant, first, taken)
        reported = -1
        while batch.running.any():
            now_ns, outputs = plant.now_ns(), batch.tick()
            if record is not None:
                record.tick(now_ns, batch.rollout.sample, outputs)
            if progress is not None and batch.ended_count != reported:
                reported = batch.ended_count
                progress(first + reported, count)
        batch_results = batch.results()
        if record is not None:
            record.end(batch_results)
        results.extend(batch_results)
    return results


class ThrowBatch:
    """Throws that run side by side, and their outcomes."""

    use_truth = False
    """Score true impacts if the plant provides them."""
    ends_at_release = False
    """End throws at the release; only for a plant that predicts impacts."""

    def __init__(
        self,
        plant: SimulatedDriver,
        params: ControlParams,
        target_m: Array,
        start_rad_m: Array,
        seed: int,
        taken: int,
        pace_ratio: float = DEFAULT_PACE_RATIO,
    ) -> None:
        """Start a throw on every machine; only the first `taken` are evaluated."""
        self._spec = params.spec
        if isinstance(plant, HasSurface):
            plant.set_surface_height(target_m[:, 2])
        self.rollout = Rollout(plant, params, target_m, start_rad_m, seed, pace_ratio=pace_ratio)
        self._taken, self._count = taken, plant.count
        low, high = params.spec.position_range_rad_m
        self._low, self._high = low[None] + LIMIT_REACHED_RAD_M, high[None] - LIMIT_REACHED_RAD_M
        self.outcome = np.full(plant.count, "", dtype="U16")
        """(N,) `ThrowOutcome`; empty while the throw runs."""
        self.outcome[taken:] = ThrowOutcome.TIMEOUT
        self.running: BoolArray = self.outcome == ""
        """(N,) throws that have not ended."""
        if taken < plant.count and isinstance(plant, Freezable):
            plant.freeze(~self.running)
        self._was_held = self.rollout.sample.payload_held.copy()
        self._impact = np.full((plant.count, 3), np.nan)
        self.release_speed_m_per_s = np.full(plant.count, np.nan)
        self.release_s = np.full(plant.count, np.nan)
        self._end_s = np.zeros(plant.count)
        self._flight_s = np.zeros(plant.count)

    @property
    def ended_count(self) -> int:
        """Throws that have ended."""
        return self._taken - int(np.count_nonzero(self.running))

    @property
    def load_gone(self) -> BoolArray:
        """(N,) whether the load is released."""
        return ~self._was_held

    def tick(self) -> ControlOutputs:
        """Advance all machines by one control tick and evaluate which throws ended."""
        outputs = self.rollout.tick()
        self._note_release(self.rollout.sample, outputs)
        if self._note_ends(self.rollout.sample, outputs):
            self.running = self.outcome == ""
            if isinstance(self.rollout.plant, Freezable):
                self.rollout.plant.freeze(~self.running)
        return outputs

    def _note_release(self, sample: SensorSample, outputs: ControlOutputs) -> None:
        left = self._was_held & ~sample.payload_held
        if np.count_nonzero(left):
            self._was_held &= sample.payload_held
            row = outputs.row[left]
            grip = grip_centre(
                self._spec, row["joint_position_rad_m"], row["joint_velocity_rad_m_per_s"]
            )
            self.release_speed_m_per_s[left] = np.linalg.norm(grip.velocity_m_per_s, axis=-1)
            self.release_s[left] = self.rollout.elapsed_s

    def _note_ends(self, sample: SensorSample, outputs: ControlOutputs) -> bool:
        """Set the outcome of throws that ended in this tick; return whether there were any."""
        rollout = self.rollout
        elapsed_s = rollout.elapsed_s
        position = sample.joint_position_rad_m
        holding = sample.payload_held
        violation = outputs.violation_count
        at_limit = (position <= self._low) | (position >= self._high)
        collided = rollout.plant.collided()
        landed = ~holding if self.ends_at_release else sample.impact_t_mono_ns > rollout.start_ns
        late = elapsed_s >= RELEASE_TIMEOUT_S - 0.5 * CONTROL_PERIOD_S
        some = self.running & (collided | landed | (violation != 0))
        if not (late or np.count_nonzero(some) or np.count_nonzero(at_limit)):
            return False
        beyond = at_limit.any(axis=-1) | ((violation & _BEYOND) != 0)
        fails = ~outputs.release_commanded & (late | ((violation & _ABORTED) != 0))
        ended = np.zeros(self._count, dtype=np.bool_)
        # The first match counts: a throw with a collision is not a good one.
        for outcome, happened in (
            (ThrowOutcome.COLLISION, collided),
            (ThrowOutcome.LIMIT, beyond & holding & (rollout.motion == _THROW)),
            (ThrowOutcome.LANDED, landed),
            (ThrowOutcome.NO_RELEASE, fails & holding),
            (ThrowOutcome.TIMEOUT, np.full(self._count, elapsed_s >= END_TIMEOUT_S)),
        ):
            new = self.running & happened & ~ended
            if new.any():
                self.outcome[new] = outcome
                ended |= new
        if not ended.any():
            return False
        self._end_s[ended] = elapsed_s
        plant = rollout.plant
        point = sample.impact_position_m
        if self.use_truth and isinstance(plant, KnowsTruth):
            point = plant.true_impact_m()
        fell = ended & (self.outcome == ThrowOutcome.LANDED)
        self._impact[fell] = point[fell]
        return True

    def results(self) -> list[ThrowResult]:
        """Results of the evaluated throws."""
        target = self.rollout.target_m
        plant = self.rollout.plant
        if self.ends_at_release and isinstance(plant, PredictsImpact):
            self._score_predictions(plant)
        down, cross = throw_errors(self._impact, target)
        return [
            ThrowResult(
                target_m=_point(target[i]),
                outcome=ThrowOutcome(str(self.outcome[i])),
                impact_m=_point(self._impact[i]),
                downrange_error_m=float(down[i]),
                crossrange_error_m=float(cross[i]),
                release_speed_m_per_s=float(self.release_speed_m_per_s[i]),
                throw_duration_s=float(self.release_s[i]),
                simulated_s=float(self._end_s[i] + self._flight_s[i]),
            )
            for i in range(self._taken)
        ]

    def _score_predictions(self, plant: PredictsImpact) -> None:
        point, flight_s = plant.predicted_impact()
        landed = self.outcome == ThrowOutcome.LANDED
        falls = landed & np.isfinite(flight_s)
        self._impact[falls] = point[falls]
        self._flight_s[falls] = flight_s[falls]
        self.outcome[landed & ~falls] = ThrowOutcome.TIMEOUT


def _point(row: Array) -> tuple[float, float, float]:
    return float(row[0]), float(row[1]), float(row[2])


def throw_errors(impact_m: Array, target_m: Array) -> tuple[Array, Array]:
    """Downrange and crossrange errors (N,) of impacts (N, 3) at targets (N, 3), frame `throw`."""
    local = to_throw_frame(impact_m, target_m)
    return local[:, 0] - np.hypot(target_m[:, 0], target_m[:, 1]), local[:, 1]


def landing_ellipse(results: Sequence[ThrowResult]) -> LandingEllipse | None:
    """Mean and standard deviation of the landed throws' errors; None if fewer than two landed."""
    landed = [r for r in results if r.outcome is ThrowOutcome.LANDED]
    if len(landed) < 2:
        return None
    down = np.array([r.downrange_error_m for r in landed])
    cross = np.array([r.crossrange_error_m for r in landed])
    sd_down, sd_cross = float(down.std(ddof=1)), float(cross.std(ddof=1))
    product = sd_down * sd_cross
    covariance = float(np.sum((down - down.mean()) * (cross - cross.mean())) / (len(landed) - 1))
    correlation = float(np.clip(covariance / product, -1.0, 1.0)) if product > 0.0 else 0.0
    return LandingEllipse(
        mean_downrange_error_m=float(down.mean()),
        mean_crossrange_error_m=float(cross.mean()),
        sd_downrange_m=sd_down,
        sd_crossrange_m=sd_cross,
        correlation_ratio=correlation,
        rollout_count=len(results),
        landed_count=len(landed),
    )
