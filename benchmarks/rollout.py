"""Rollouts to 20 simulated machines: false pauses, and regressions that are caught.

    python -m benchmarks.rollout [--rollouts 100] [--json FILE]

The product's rules and stage test decide, by a clock of the simulation. Each machine has its own spread and
mean miss, misses along and across are correlated, all throw at once. A regressed machine throws with twice
its spread from the switch on; a silent one never answers.
"""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import tyro

from benchmarks.result_file import (
    RESULTS,
    Row,
    describe,
    percentile,
    ratio,
    row,
    write_result,
)
from evaluation.validation.gates import DEFAULT_GATES
from server.rollouts.rollout_rules import Decision, MachineStanding, Next, decide
from server.rollouts.stage_test import FALSE_ALARM_RATIO, StageThrow, stage_test

STAGES = (1, 5, 14)
"""Machines of each stage."""
MACHINE_COUNT = sum(STAGES)
THROWS_COUNT = 12
DEADLINE_S = 600.0
THROW_PERIOD_S = 120.0
SWITCH_S = 30.0
CORRELATION = 0.3
WIDE_RATIO = 2.0
REFERENCE_COUNTS = (300, 100, 30)
SEED = 38
T0 = datetime(2026, 1, 1, tzinfo=UTC)
GATES = DEFAULT_GATES["2d"]


@dataclass
class SimulatedMachine:
    """A machine with throws of before."""

    name: str
    sd_m: np.ndarray
    mean_m: np.ndarray
    reference: list[StageThrow]
    is_silent: bool = False
    ratio: float = 1.0
    """Spread since the switch over that of before."""
    asked_s: float | None = None
    since: list[StageThrow] = field(default_factory=list)

    def throw(self, rng: np.random.Generator, count: int, ratio: float) -> list[StageThrow]:
        scatter = rng.standard_normal((count, 2))
        scatter[:, 1] = CORRELATION * scatter[:, 0] + np.sqrt(1.0 - CORRELATION**2) * scatter[:, 1]
        return [StageThrow(*one) for one in (self.mean_m + ratio * self.sd_m * scatter).tolist()]

    def is_aboard(self, now_s: float) -> bool:
        return not self.is_silent and self.asked_s is not None and now_s >= self.asked_s + SWITCH_S

    def standing(self, now_s: float) -> MachineStanding:
        finding = stage_test(
            self.reference,
            self.since,
            GATES,
            machine_count=MACHINE_COUNT,
            throws_count=THROWS_COUNT,
        )
        asked_utc = None if self.asked_s is None else T0 + timedelta(seconds=self.asked_s)
        worse = f"{self.name}: {finding.regression}" if finding.regression else ""
        return MachineStanding(self.name, asked_utc, self.is_aboard(now_s), "", finding, worse)


@dataclass
class Ending:
    """How a rollout ended."""

    next: Next
    sentence: str
    throw_count: int
    """Throws of the machine that ended it."""


def machines(rng: np.random.Generator, reference_count: int) -> list[SimulatedMachine]:
    found: list[SimulatedMachine] = []
    for number in range(MACHINE_COUNT):
        sd_m = np.array([0.05, 0.03]) * rng.uniform(0.8, 1.3, 2)
        machine = SimulatedMachine(
            f"m{number + 1:03d}", sd_m, rng.normal(0.0, 0.01, 2), reference=[]
        )
        machine.reference = machine.throw(rng, reference_count, 1.0)
        found.append(machine)
    return found


def roll_out(rng: np.random.Generator, fleet: list[SimulatedMachine]) -> Ending:
    """Roll out until the rules end it or stop it."""
    now_s, began_s, stage = 0.0, 0.0, 0
    while True:
        first = sum(STAGES[:stage])
        members = fleet[first : first + STAGES[stage]]
        decision: Decision = decide(
            [machine.standing(now_s) for machine in members],
            now_utc=T0 + timedelta(seconds=now_s),
            resumed_utc=T0 + timedelta(seconds=began_s),
            deadline_s=DEADLINE_S,
            is_last=stage + 1 == len(STAGES),
            is_paused=False,
        )
        if decision.next is Next.ASK:
            for machine in members:
                machine.asked_s = now_s
        elif decision.next is Next.NEXT_STAGE:
            stage, began_s = stage + 1, now_s
        elif decision.next is not Next.WAIT:
            counts = [len(m.since) for m in members if decision.sentence.startswith(m.name)]
            return Ending(decision.next, decision.sentence, counts[0] if counts else 0)
        else:
            now_s += THROW_PERIOD_S
            for machine in members:
                if machine.is_aboard(now_s):
                    machine.since += machine.throw(rng, 1, machine.ratio)


def measure(scenario: str, reference_count: int, rollouts: int) -> Row:
    endings: list[tuple[Ending, str]] = []
    for number in range(rollouts):
        kind = ("healthy", "one regresses", "one regresses, one silent").index(scenario)
        rng = np.random.default_rng([SEED, reference_count, kind, number])
        fleet = machines(rng, reference_count)
        wide, silent = rng.choice(MACHINE_COUNT, 2, replace=False)
        if kind > 0:
            fleet[wide].ratio = WIDE_RATIO
        if kind > 1:
            fleet[silent].is_silent = True
        endings.append((roll_out(rng, fleet), fleet[wide].name if kind > 0 else ""))
    caught = [
        ending.throw_count
        for ending, wide in endings
        if wide and ending.next is Next.ROLL_BACK and ending.sentence.startswith(wide)
    ]
    ends = [ending.next for ending, _ in endings]
    assert all(e.sentence for e, _ in endings if e.next in (Next.ROLL_BACK, Next.PAUSE))
    return row(
        rollouts,
        {"rollouts": scenario, "throws_before": reference_count},
        {
            "completed_ratio": ratio(ends.count(Next.COMPLETE), rollouts),
            "paused_ratio": ratio(ends.count(Next.PAUSE), rollouts),
            "rolled_back_ratio": ratio(ends.count(Next.ROLL_BACK), rollouts),
            "caught_ratio": ratio(len(caught), rollouts) if scenario != "healthy" else None,
            "caught_after_throws_count": percentile(caught, 50),
        },
    )


def main(rollouts: int = 100, json: Path = RESULTS / "rollout.json") -> None:
    """Measure and write the result.

    Args:
        rollouts: of each kind.
        json: where the result is written.
    """
    rows = [measure("healthy", count, rollouts) for count in REFERENCE_COUNTS]
    rows += [measure("one regresses", count, rollouts) for count in REFERENCE_COUNTS]
    rows.append(measure("one regresses, one silent", REFERENCE_COUNTS[0], rollouts))
    result = describe(
        "rollout",
        "Rollouts to 20 machines: how they end, and regressed machines that are caught within 12 throws",
        rows,
        seed=SEED,
        notes=f"stated: at most {FALSE_ALARM_RATIO:.0%} of healthy rollouts rolled back; spread doubled",
    )
    for line in rows:
        print(line.n, *line.labels.values(), *(v.value for v in line.values.values()))
    print(write_result(result, json))


if __name__ == "__main__":
    tyro.cli(main)
