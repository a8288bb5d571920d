"""Validations: plans, parts that run anywhere and once, and gates that each refuse what they are for."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.execution.executor import LocalProcesses
from evaluation.measures import Estimate, TargetRow, deviation_estimate, mean_estimate
from evaluation.validation.gates import DEFAULT_GATES, Gates, check_gates
from evaluation.validation.parts import PartAnswer, VersionFiles, read_version
from evaluation.validation.protocol import PROTOCOLS, make_plan
from evaluation.validation.results import Latency, UnitLandings, VersionResult
from evaluation.validation.validation import ValidationJob, ValidationListener, validate
from machine.errors import PolicyError
from machine.policy_card import load_card
from runtime.records.log_reader import read_throw_log
from tests.cases import each


def version(policies: Path, name: str) -> VersionFiles:
    return read_version(policies / name, load_card(policies / name).policy_sha256)


@pytest.fixture(scope="module")
def job(swing_policies: Path) -> ValidationJob:
    """A version that stands still beside one that throws, on the twin, which is quick."""
    cards = [load_card(swing_policies / name) for name in ("waits-2d", "swing-2d")]
    plan = make_plan(cards, "short", throws_per_target=2, unseen_unit_count=0, seed=3)
    return ValidationJob(
        plan=plan.model_copy(update={"plant": "twin", "ranges_m": plan.ranges_m[:1]}),
        gates=DEFAULT_GATES["2d"],
        candidate=version(swing_policies, "waits-2d"),
        active=version(swing_policies, "swing-2d"),
        finished={},
    )


class Told:
    """What a validation has told."""

    def __init__(self) -> None:
        self.shares: list[float] = []
        self.parts: dict[str, PartAnswer] = {}
        self.listener = ValidationListener(
            progress=lambda share, text: self.shares.append(share),
            part=self.parts.__setitem__,
        )


class Counting:
    """Runs in this process and counts."""

    worker_count = 1

    def __init__(self) -> None:
        self.task_count = 0

    def run(self, tasks: Sequence[Callable[[], Any]]) -> Iterator[tuple[int, Any]]:
        self.task_count += len(tasks)
        yield from LocalProcesses(1).run(tasks)


def landings(result: Any) -> str:
    """Everything but times."""
    return repr([part.units for part in (result.candidate, result.active)])


def test_a_validation_is_the_same_by_two_processes_and_when_it_goes_on(
    job: ValidationJob, tmp_path: Path
):
    told = Told()
    whole = validate(job, LocalProcesses(2), told.listener)
    assert sorted(told.parts) == sorted({p.name for p in _parts(job)})
    assert told.shares == sorted(told.shares)
    assert told.shares[-1] < 1.0 or told.shares[-1] == pytest.approx(1.0)
    # Half of it is known already.
    counting, first = Counting(), next(iter(told.parts))
    again = validate(
        job._replace(finished={first: told.parts[first].landings}), counting, Told().listener
    )
    assert counting.task_count == 1
    assert landings(again) == landings(whole)
    # It stands still: each throw is a failure that can be replayed.
    (unit,) = whole.candidate.units
    assert unit.is_repeatable is True
    assert len(unit.failures) == 2
    assert not whole.is_passed
    failed = {check.gate for check in whole.checks if not check.is_passed}
    assert {"landed", "sd_downrange", "mean_downrange"} <= failed
    name = unit.failures[0].log
    assert name is not None
    log = tmp_path / name
    log.write_bytes(told.parts[f"{job.candidate.policy_sha256[:16]}/0"].logs[name])
    assert read_throw_log(log).metadata["policy_id"] == job.candidate.policy_id


def _parts(job: ValidationJob) -> list[Any]:
    from evaluation.validation.parts import ValidationPart

    versions = [job.candidate, *([] if job.active is None else [job.active])]
    return [ValidationPart(v, job.plan, unit) for v in versions for unit in job.plan.unit_seeds]


def test_machines_and_seed_are_drawn_and_targets_are_in_reach(swing_policies: Path):
    card = load_card(swing_policies / "swing-2d")
    plans = [make_plan([card], "full") for _ in range(2)]
    assert plans[0].unit_seeds != plans[1].unit_seeds
    for plan in plans:
        assert plan.unit_seeds[0] == 0
        assert len(set(plan.unit_seeds)) == PROTOCOLS["full"].unseen_unit_count + 1
        assert all(seed >= 2000 for seed in plan.unit_seeds[1:])
        assert plan.throws_of(0) == 200
        assert plan.throws_of(plan.unit_seeds[1]) == 60
        assert all(card.target_range_min_m <= r <= card.target_range_max_m for r in plan.ranges_m)
    near = card.model_copy(update={"target_range_min_m": 5.5, "target_range_max_m": 6.5})
    ranges = make_plan([card, near], "short").ranges_m
    assert len(ranges) == 3
    assert all(5.5 < r < 6.5 for r in ranges)


def test_a_folder_with_another_version_is_refused(swing_policies: Path):
    sha256 = load_card(swing_policies / "swing-2d").policy_sha256
    with pytest.raises(PolicyError, match="another version"):
        read_version(swing_policies / "waits-2d", sha256)


# Gates ----------------------------------------------------------------------------------------------------

GATES = Gates(sd_m=0.1, mean_m=0.05, landed_ratio=0.9, latency_s=0.01, worse_ratio=1.2)


def unit(seed: int = 0, sd_m: float = 0.05, mean_m: float = 0.0, lost: int = 0) -> UnitLandings:
    """Forty throws at each of two targets; exactly this mean and spread, both ways."""
    rows: list[TargetRow] = []
    for range_m in (8.0, 9.0):
        count = 40 - lost
        shape = np.random.default_rng(seed).normal(size=count)
        errors = mean_m + sd_m * (shape - shape.mean()) / shape.std(ddof=1)
        rows.append(
            TargetRow(
                range_m=range_m,
                throws=40,
                landed=count,
                success_ratio=Estimate(value=count / 40, ci95=None),
                mean_downrange_error_m=mean_estimate(errors),
                sd_downrange_m=deviation_estimate(errors),
                mean_crossrange_error_m=mean_estimate(errors),
                sd_crossrange_m=deviation_estimate(errors),
                downrange_error_m=tuple(errors.tolist()),
                crossrange_error_m=tuple(errors.tolist()),
            )
        )
    return UnitLandings(
        unit_seed=seed,
        is_registered=True,
        registration_note="",
        targets=tuple(rows),
        failures=(),
        is_repeatable=True if seed == 0 else None,
    )


def result(*units: UnitLandings, p99_s: float = 0.001) -> VersionResult:
    latency = Latency(p50_s=p99_s / 2, p99_s=p99_s, run_count=100)
    return VersionResult(policy_id="v", policy_sha256="a" * 64, units=units, latency=latency)


BOTH = ("downrange", "crossrange")


@each(
    ("candidate", "failed"),
    [
        (result(unit(), unit(7)), set()),
        (result(unit(), unit(7, sd_m=0.11)), {f"sd_{way}" for way in BOTH} | {"worse"}),
        (result(unit(), unit(7, mean_m=-0.06)), {f"mean_{way}" for way in BOTH}),
        (result(unit(lost=5), unit(7, lost=5)), {"landed"}),
        (result(unit(), p99_s=0.02), {"latency"}),
        (result(unit().model_copy(update={"is_repeatable": False})), {"repeatable"}),
        (result(unit(sd_m=0.062)), {"worse"}),
    ],
)
def test_each_gate_refuses_what_it_is_for(candidate: VersionResult, failed: set[str]):
    wanted = (failed - {"worse"}) | (
        {f"worse_{way}" for way in BOTH} if "worse" in failed else set()
    )
    checks = check_gates(GATES, candidate, result(unit(), unit(7)))
    assert {check.gate for check in checks if not check.is_passed} == wanted
    alone = check_gates(GATES, candidate, None)
    assert not {check.gate for check in alone} & {"worse_downrange", "worse_crossrange"}


def test_numbers_of_the_gates_are_those_of_the_throws():
    checks = {c.gate: c for c in check_gates(GATES, result(unit(sd_m=0.08)), result(unit()))}
    sd = checks["sd_downrange"]
    assert sd.value == pytest.approx(0.08, abs=1e-4)
    assert sd.ci95 is not None
    assert sd.ci95[0] < 0.08 < sd.ci95[1]
    assert checks["worse_downrange"].value == pytest.approx(1.6, abs=1e-3)
    assert checks["landed"].where == "80 of 80"
