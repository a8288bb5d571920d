"""What a rollout does next, from where its machines stand; pure, so that a simulation decides alike."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from server.rollouts.stage_test import StageFinding


@dataclass(frozen=True, slots=True)
class MachineStanding:
    """Where a machine of the present stage stands."""

    machine_id: str
    asked_utc: datetime | None
    """When it was asked to switch; None before."""
    is_aboard: bool
    """It throws with the version, by its own events."""
    problem: str = ""
    """Why it does not, or no longer, in a sentence that begins with its name."""
    finding: StageFinding | None = None
    worse: str = ""
    """How it is worse, in a sentence with the numbers."""


class Next(StrEnum):
    """What is done."""

    WAIT = "wait"
    ASK = "ask"
    """Ask the machines of the stage that were not asked yet."""
    PAUSE = "pause"
    ROLL_BACK = "roll_back"
    NEXT_STAGE = "next_stage"
    COMPLETE = "complete"


@dataclass(frozen=True, slots=True)
class Decision:
    """What is done next, and why."""

    next: Next
    sentence: str = ""


def decide(
    machines: Sequence[MachineStanding],
    *,
    now_utc: datetime,
    resumed_utc: datetime,
    deadline_s: float,
    is_last: bool,
    is_paused: bool,
) -> Decision:
    """Decide about a stage.

    Args:
        machines: of the stage.
        now_utc: time.
        resumed_utc: when the stage began or the rollout was last resumed; deadlines count from then.
        deadline_s: within which a machine has to switch after it was asked.
        is_last: no stage follows.
        is_paused: only throws that are worse still change anything.
    """
    for machine in machines:
        if machine.finding is not None and machine.finding.verdict == "worse":
            return Decision(Next.ROLL_BACK, machine.worse)
    if is_paused:
        return Decision(Next.WAIT)
    if any(machine.asked_utc is None for machine in machines):
        return Decision(Next.ASK)
    problems = [machine.problem for machine in machines if machine.problem]
    if problems:
        return Decision(Next.PAUSE, " ".join(problems))
    late = [
        machine.machine_id
        for machine in machines
        if machine.asked_utc is not None
        and not machine.is_aboard
        and now_utc > max(machine.asked_utc, resumed_utc) + timedelta(seconds=deadline_s)
    ]
    if late:
        does = "has" if len(late) == 1 else "have"
        return Decision(
            Next.PAUSE,
            f"{', '.join(late)} {does} not switched within {deadline_s:.0f} s: off, out of reach, or with a "
            "plan armed.",
        )
    if all(m.is_aboard and m.finding and m.finding.verdict == "passed" for m in machines):
        return Decision(Next.COMPLETE if is_last else Next.NEXT_STAGE)
    return Decision(Next.WAIT)
