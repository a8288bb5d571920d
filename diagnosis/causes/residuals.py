"""Measured minus twin, channel by channel, each stage driven by the measured motion above it; and its slopes.

Three simulations of every throw (`View`): the joints from their valve commands; the swing from the measured
joints; the flight from the measured joints, swing and opening. Slopes are finite differences of the very
same simulations, all in one batch. Blocks (channels) of a throw:

    actuation.<joint>   joint velocity, rad/s or m/s, given the valve commands
    swing.gyro.<axis>, swing.accel.<axis>   IMU, given the measured joints
    release.switch      time of the opening given the command, s
    flight.ball, flight.impact    tracked and surveyed positions given the measured motion of the gripper, m
"""

from collections.abc import Collection, Iterator, Sequence

from diagnosis.causes.elements import (
    Part,
    Plan,
    Shared,
    moved_inputs,
    moved_parameters,
    part_about,
)
from diagnosis.causes.linear import Known, Linear, linear_of
from diagnosis.causes.parameters import Parameter, View, library
from diagnosis.healthy.filters import HealthyModel
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.simulate import simulate
from machine.calibration import ValveCalibration
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import TwinProfile

THROWS_COUNT = 24
"""Throws linearised side by side: each of 36 took 14 MiB."""
BATCH_COUNT = 700
"""Simulations side by side, beyond which no further set joins them (by eye)."""


def linearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
) -> list[Linear]:
    """Residuals and slopes of every throw without any effect, some throws side by side.

    Args:
        prepared: the throws.
        profile: of the machine.
        calibration: of its valves.
        healthy: what the twin misses on every machine.
    """
    found: list[Linear] = []
    for first in range(0, len(prepared), THROWS_COUNT):
        some = prepared[first : first + THROWS_COUNT]
        found += _linearise(some, profile, calibration, healthy)
    return found


def _linearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
) -> list[Linear]:
    inputs = [p.input for p in prepared]
    plan = Plan()
    parts: list[Part] = []
    for i in range(len(prepared)):
        bases = {view: plan.add(i, (), view) for view in View}
        moves = moved_parameters(plan, i, (), library(), tuple(View))
        parts.append(Part(bases, moves, moved_inputs(plan, inputs, i)))
    output = simulate(inputs, plan.elements, plan.views, profile, calibration)
    return [
        linear_of(p, output, part, (), profile, healthy, None, {})
        for p, part in zip(prepared, parts, strict=True)
    ]


def relinearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
    first: Sequence[Linear],
    requests: Sequence[tuple[tuple[Effect, ...], Sequence[Parameter]]],
    views: Sequence[View] | None = None,
    *,
    followed: Collection[View] = (View.ACTUATION,),
) -> Iterator[list[Linear]]:
    """Every throw about several sets of effects, one set after the other, simulated side by side.

    Only the views that a set moves are simulated; everything else is as in `first`. So are slopes of other
    parameters than those wanted, but for what follows the motion: behind valves that answer later or less
    all that a joint does is later or less (elements.py), and a late IMU reports all of the swing late. With
    slopes of "no effect" an IMU that was 0.046 s late was told best at 0.039 s, and a telescope's valve that
    was 0.27 s late came out as 0.31 s.

    Args:
        prepared: the throws.
        profile: of the machine.
        calibration: of its valves.
        healthy: what the twin misses on every machine.
        first: linearised without any effect.
        requests: effects about which to linearise, and the parameters whose slopes are wanted.
        views: to simulate; those that the wanted parameters move if left out.
        followed: views in which all slopes are taken about the set, where it moves them: those of the swing
            cost some seconds a set. About a gripper that is longer by 0.27 m, with the slopes of the swing at
            none, inertia was named beside the length, which has 257 more of log evidence with those about it.
    """
    inputs = [p.input for p in prepared]
    waiting = list(requests)
    while waiting:
        plan = Plan()
        shared: Shared = {}
        parts: list[list[Part]] = []
        while len(parts) < len(waiting) and len(plan.elements) < BATCH_COUNT:
            effects, wanted = waiting[len(parts)]
            moved = tuple(view for view in View if any(view in p.views for p in wanted))
            about = effects, wanted, moved if views is None else tuple(views)
            throws = range(len(prepared))
            parts.append([part_about(plan, shared, i, *about, followed=followed) for i in throws])
        output = simulate(inputs, plan.elements, plan.views, profile, calibration)
        known: Known = {}
        for (effects, _), row in zip(waiting, parts, strict=False):
            yield [
                linear_of(p, output, part, effects, profile, healthy, before, known)
                for p, part, before in zip(prepared, row, first, strict=True)
            ]
        waiting = waiting[len(parts) :]
