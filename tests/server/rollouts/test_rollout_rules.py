"""What a rollout does next."""

from datetime import UTC, datetime, timedelta

from server.rollouts.rollout_rules import MachineStanding, Next, decide
from server.rollouts.stage_test import StageFinding
from tests.cases import each

T0 = datetime(2026, 1, 1, tzinfo=UTC)
PASSED = StageFinding("passed", None, 12, None)
TESTING = StageFinding("testing", None, 6, None)
WORSE = StageFinding("worse", None, 6, 1e-6)


def machine(name="m001", *, asked=True, aboard=True, finding=TESTING, problem="", worse=""):
    return MachineStanding(name, T0 if asked else None, aboard, problem, finding, worse)


def after(seconds, *machines, resumed_s=0.0, is_last=False, is_paused=False):
    return decide(
        machines,
        now_utc=T0 + timedelta(seconds=seconds),
        resumed_utc=T0 + timedelta(seconds=resumed_s),
        deadline_s=60.0,
        is_last=is_last,
        is_paused=is_paused,
    )


@each(
    ("machines", "following"),
    [
        ((machine(asked=False, aboard=False, finding=None),), Next.ASK),
        ((machine(aboard=False),), Next.WAIT),
        ((machine(), machine("m002", finding=PASSED)), Next.WAIT),
        ((machine(finding=PASSED), machine("m002", finding=PASSED)), Next.NEXT_STAGE),
        ((machine(problem="m001 refused it."),), Next.PAUSE),
        ((machine(problem="m001 refused it."), machine("m002", finding=WORSE)), Next.ROLL_BACK),
    ],
)
def test_what_follows(machines, following):
    assert after(1.0, *machines).next is following


def test_the_last_stage_completes():
    assert after(1.0, machine(finding=PASSED), is_last=True).next is Next.COMPLETE


def test_a_deadline_counts_from_the_question_or_the_last_resumption():
    silent = machine(aboard=False)
    late = after(61.0, silent, machine("m002"))
    assert late.next is Next.PAUSE
    assert late.sentence.startswith("m001 has not switched within 60 s")
    assert after(61.0, silent, resumed_s=30.0).next is Next.WAIT
    assert after(91.0, silent, resumed_s=30.0).next is Next.PAUSE


def test_while_paused_only_worse_throws_change_anything():
    assert after(99.0, machine(aboard=False), is_paused=True).next is Next.WAIT
    assert after(1.0, machine(finding=PASSED), is_paused=True).next is Next.WAIT
    assert after(1.0, machine(finding=WORSE), is_paused=True).next is Next.ROLL_BACK
