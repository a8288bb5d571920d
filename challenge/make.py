"""Makes the data sets of a challenge: throws of virtual machines with hidden effects, and the sealed truth.

A data set holds throw logs, the twin profile and the calibration of the healthy machine, and nothing else.
The truth goes to one sealed file, whose hash is published beside the data.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from challenge.detection_limits import load_limits
from challenge.healthy_machines import HealthyMachine, healthy_machine, nuisance_unit
from challenge.sealed_truth import SetTruth, Tier, draw_truths, weaker
from machine.conventions import Array, Mode
from machine.errors import UsageError
from machine.spec import MachineSpec, load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from runtime.records.throw_log import ThrowLog
from sim_twin.child_processes import process_pool
from sim_twin.throws.campaign import ThrowOutcome, run_throws
from sim_twin.throws.throw_logs import CampaignRecorder, LogContext
from sim_twin.twin.profile import save_profile
from sim_twin.virtual_machine import STEP_NS, Condition, VirtualMachine

RANGE_M: Final = (7.0, 10.0)
LOST_ROW_RATIO: Final = 0.01
FINER_RATIO: Final = 4
LEAST_LANDED_RATIO: Final = 2 / 3
"""Share of a set's throws that must land; otherwise its effects are weakened."""
WEAKER_RATIO: Final = 0.7
MAX_ATTEMPTS: Final = 6
MANIFEST: Final = "manifest.json"
REFERENCE: Final = "reference"
"""Folder of the machines' healthy throws, beside the sets."""
PROFILE_NAME: Final = "profile.json"
CALIBRATION_NAME: Final = "calibration.json"

Progress = Callable[[int, int], None]
Result = TypeVar("Result")


class ModeThrows(NamedTuple):
    """Throws of one mode in a set."""

    mode: Mode
    numbers: tuple[int, ...]
    target_m: Array
    """(N, 3) frame `machine`."""
    start_rad_m: Array
    """(N, 6)"""


class LossyRecorder(CampaignRecorder):
    """Writes logs that lack some of their rows, as those of a busy machine do."""

    def __init__(self, params: ControlParams, context: LogContext, seed: int) -> None:
        super().__init__(params, context)
        self._rng = np.random.default_rng([seed, 0x105])

    def store(self, throw_id: str, log: ThrowLog) -> None:
        """Lose 1 % of the rows, never the first or the last."""
        super().store(
            throw_id,
            replace(
                log,
                control=self._thinned(log.control),
                imu=self._thinned(log.imu),
                ball=self._thinned(log.ball),
            ),
        )

    def _thinned(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        keep = self._rng.random(rows.size) >= LOST_ROW_RATIO
        keep[:1] = keep[-1:] = True
        return rows[keep]


def plan_throws(spec: MachineSpec, throws: int, rng: np.random.Generator) -> list[ModeThrows]:
    """Targets anywhere between 7 and 10 m, random starts, the modes by turns."""
    plans: list[ModeThrows] = []
    for first, mode in enumerate((Mode.PLANAR, Mode.SPATIAL)):
        numbers = tuple(range(first, throws, 2))
        if not numbers:
            continue
        reach = rng.uniform(*RANGE_M, len(numbers))
        azimuth = rng.uniform(-np.pi, np.pi, len(numbers))
        target_m = np.stack(
            [reach * np.cos(azimuth), reach * np.sin(azimuth), np.zeros(len(numbers))], axis=1
        )
        plans.append(ModeThrows(mode, numbers, target_m, sample_starts(spec, mode, target_m, rng)))
    return plans


@cache
def open_policy(folder: Path, mode: Mode) -> PolicyRunner:
    """The active policy of a mode, loaded once a process."""
    return PolicyRunner(find_policy(folder, mode), load_spec())


def plant_condition(truth: SetTruth, machine: HealthyMachine, place_ratio: Array) -> Condition:
    """The machine of a set as the virtual machine takes it."""
    crossed = truth.tier is Tier.CROSS
    return Condition(
        effects=tuple(effect.in_plant() for effect in truth.effects),
        place_ratio=place_ratio,
        unit=nuisance_unit(machine.unit, np.random.default_rng([truth.seed, 0x2])),
        step_ns=STEP_NS // FINER_RATIO if crossed else STEP_NS,
        integrator=mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if crossed
        else mujoco.mjtIntegrator.mjINT_EULER,
    )


def make_set(truth: SetTruth, out: Path, throws: int, policies: Path) -> SetTruth:
    """Throw one set into OUT/SET; returns the truth, with weaker effects if too little landed."""
    machine = healthy_machine(load_spec(), truth.unit_seed)
    folder = out / truth.set_id
    for _ in range(MAX_ATTEMPTS):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        thrower = _Thrower(machine, folder, truth.set_id, truth.seed, policies)
        landed = thrower.throw(throws, partial(plant_condition, truth, machine))
        truth = truth.model_copy(update={"landed_count": landed})
        if landed >= LEAST_LANDED_RATIO * throws or not truth.effects:
            break
        truth = weaker(truth, WEAKER_RATIO)
    save_profile(machine.profile, folder / PROFILE_NAME)
    text = machine.calibration.model_dump_json(indent=2) + "\n"
    (folder / CALIBRATION_NAME).write_text(text, encoding="utf-8")
    return truth


def make_reference(unit_seed: int, seed: int, out: Path, throws: int, policies: Path) -> Path:
    """Throws of a machine as it was measured, without nuisance, into OUT/reference/MACHINE."""
    machine = healthy_machine(load_spec(), unit_seed)
    name = machine.calibration.machine_id
    folder = out / REFERENCE / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    thrower = _Thrower(machine, folder, f"{name}-healthy", seed, policies)
    thrower.throw(throws, lambda place: Condition(place_ratio=place, unit=machine.unit))
    save_profile(machine.profile, folder / PROFILE_NAME)
    return folder


class _Thrower(NamedTuple):
    """One machine, and where its logs go."""

    machine: HealthyMachine
    folder: Path
    throw_prefix: str
    seed: int
    policies: Path

    def throw(self, throws: int, condition: Callable[[Array], Condition]) -> int:
        """Throws that landed, of `throws` under the condition that belongs to their places in the set."""
        spec, machine = load_spec(), self.machine
        landed = 0
        for plan in plan_throws(spec, throws, np.random.default_rng([self.seed, 0x1])):
            params = ControlParams(
                spec=spec,
                calibration=machine.calibration,
                mode=plan.mode,
                policy=open_policy(self.policies, plan.mode),
            )
            context = LogContext(
                machine_id=machine.calibration.machine_id,
                throw_prefix=self.throw_prefix,
                twin_profile_version_count=machine.profile.version_count,
                out_dir=self.folder,
                twin_profile=machine.profile,
                throw_numbers=plan.numbers,
            )
            plant = VirtualMachine(
                count=len(plan.numbers),
                unit_seed=machine.unit.unit_seed,
                condition=condition(np.array(plan.numbers) / max(throws - 1, 1)),
            )
            seed = self.seed + (plan.mode is Mode.SPATIAL)
            recorder = LossyRecorder(params, context, seed)
            results = run_throws(
                plant, params, plan.target_m, plan.start_rad_m, seed, record=recorder
            )
            landed += sum(result.outcome is ThrowOutcome.LANDED for result in results)
        return landed


def make_challenge(
    *,
    seed: int,
    out: Path,
    sealed: Path,
    sets: int,
    throws: int,
    policies: Path,
    reference_throws: int = 12,
    tiers: Sequence[Tier] = tuple(Tier),
    jobs: int = 2,
    progress: Progress | None = None,
) -> list[SetTruth]:
    """Make a whole challenge.

    Args:
        seed: of everything.
        out: folder for the data.
        sealed: file for the truth.
        sets: data sets in all.
        throws: throws of each set.
        policies: that throw.
        reference_throws: throws of each machine while it was healthy; 0 for none.
        tiers: kinds of sets.
        jobs: processes side by side.
        progress: called with the sets done and the sets in all.

    Raises:
        UsageError: the sealed file would lie among the data, the folder holds something else, or nothing
            is asked for.
    """
    _check_places(out, sealed)
    truths = draw_truths(seed, sets, load_limits(), tiers)
    for unit_seed in sorted({truth.unit_seed for truth in truths}):
        healthy_machine(load_spec(), unit_seed)
        if reference_throws:
            make_reference(unit_seed, seed, out, reference_throws, policies)
    done: dict[str, SetTruth] = {}
    for truth in spread([(t, out, throws, policies) for t in truths], make_set, jobs):
        done[truth.set_id] = truth
        if progress is not None:
            progress(len(done), len(truths))
    final = [done[truth.set_id] for truth in truths]
    document: dict[str, Any] = {
        "schema_version": 1,
        "seed": seed,
        "throws": throws,
        "sets": [truth.model_dump(mode="json") for truth in final],
    }
    text = json.dumps(document, indent=1) + "\n"
    sealed.write_text(text, encoding="utf-8")
    manifest = {
        "schema_version": 1,
        "sealed_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "sets": [truth.set_id for truth in final],
        "throws_per_set_count": throws,
        "reference_throws_count": reference_throws,
    }
    (out / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return final


def spread(
    tasks: Sequence[tuple[Any, ...]], work: Callable[..., Result], jobs: int
) -> Iterator[Result]:
    """Results of ``work(*task)`` as they come: in this process for 1 job, else in as many others."""
    if jobs == 1:
        for task in tasks:
            yield work(*task)
        return
    with process_pool(jobs) as pool:
        waiting = [pool.submit(work, *task) for task in tasks]
        for future in as_completed(waiting):
            yield future.result()


def _check_places(out: Path, sealed: Path) -> None:
    if out.resolve() in sealed.resolve().parents:
        raise UsageError(
            f"--sealed {sealed} lies inside --out {out}: the truth must not travel with the data"
        )
    if not sealed.parent.is_dir():
        raise UsageError(f"cannot write {sealed}: the folder {sealed.parent} does not exist")
    if out.is_dir() and any(
        p.name not in (MANIFEST, REFERENCE) and not p.name.startswith("set-") for p in out.iterdir()
    ):
        raise UsageError(f"--out {out} holds other files; give an empty folder")
    out.mkdir(parents=True, exist_ok=True)
