"""`downrange job`: plan the loads of a job with bulk material, simulate it, write its report."""

import json as json_text
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from bulk.goal import progress
from bulk.job_file import BulkJob, read_job
from bulk.job_report import job_html, job_json, load_json, progress_json, run_json
from bulk.placement import middle_height_m
from bulk.planner import LoadPlanner
from bulk.previewed_throws import open_policies, previewed_models
from bulk.simulation import Truth, planned_rule, simulate_job
from bulk.throw_model import LandingScatter, ThrowModel, measured_model
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.errors import UsageError
from machine.spec import load_spec

JobPath = tyro.conf.Positional[Path]


def plan(
    file: JobPath, /, *, policies: Path = Path("policies"), policy: Path | None = None, json: bool = False,
) -> int:  # fmt: skip
    """Choose the next three loads of a job, with the reason for each. Nothing is thrown.

    Example: downrange job plan truck.json

    Exit code 0 with loads, 2 where no load would bring the surface nearer to the goal, 1 on an error.

    Args:
        file: the job (docs/bulk.md).
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version, instead of the active ones.
        json: print the plan as JSON.
    """
    job = read_job(file)
    models = _models(job, policies, policy)
    loads = _planner(job, models).next_loads(job.field)
    state = progress(job.goal, job.field, job.field)
    if json:
        content = {
            "job": job_json(job, models),
            "progress": progress_json(state),
            "loads": [load_json(load) for load in loads],
        }
        print(json_text.dumps(content, indent=2, allow_nan=False))
    else:
        grab = f"{job.file.grab_m3:.2f} m3 ({job.material.mass_kg(job.file.grab_m3):.0f} kg)"
        print(
            f"{job.file.name}: {state.missing_m3:.2f} m3 {job.material.name} missing, full grab {grab}"
        )
        for number, load in enumerate(loads, start=1):
            print(f"{number}. {load.sentence}")
        if not loads:
            print("no load would bring the surface nearer to the goal")
    return 0 if loads else 2


def simulate(
    file: JobPath, /, *, output: Path, seed: int = 0, loads: int = 200, repose_ratio: float = 1.0,
    bias: tuple[float, float] = (0.0, 0.0), policies: Path = Path("policies"), policy: Path | None = None,
) -> int:  # fmt: skip
    """Throw a whole job in simulation and write its course as JSON, for `downrange job report`.

    The material piles up as it would; the truth may differ from what the planner knows.

    Example: downrange job simulate truck.json --output run.json --repose-ratio 0.9 --bias 0.1 0.0

    Args:
        file: the job (docs/bulk.md).
        output: the JSON file to write.
        seed: of scatter and grains.
        loads: most loads of the job.
        repose_ratio: tangent of the true angle of repose over the known one.
        bias: mean landing error downrange and crossrange, metres.
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version, instead of the active ones.
    """
    if seed < 0 or loads < 1 or not 0.3 <= repose_ratio <= 2.0 or not np.abs(bias).max() <= 2.0:
        raise UsageError(
            f"--seed {seed} --loads {loads} --repose-ratio {repose_ratio:g} --bias {bias[0]:g} {bias[1]:g}: "
            "0 or more, 1 or more, 0.3 to 2, at most 2 m"
        )
    if not output.resolve().parent.is_dir():
        raise UsageError(f"cannot write {output}: the folder {output.parent} does not exist")
    job = read_job(file)
    models = _models(job, policies, policy)
    run = simulate_job(
        job.goal,
        job.field,
        models,
        planned_rule(_planner(job, models)),
        Truth(repose_ratio * job.material.slope_ratio, bias),
        np.random.default_rng(seed),
        loads,
    )
    content = run_json(job, models, run, seed)
    output.write_text(json_text.dumps(content, allow_nan=False) + "\n", encoding="utf-8")
    if not run.loads:
        print("no load was thrown: none would bring the surface nearer to the goal")
        return 2
    end = run.loads[-1].after
    print(
        f"{len(run.loads)} loads, {run.thrown_m3:.2f} m3: {100.0 * end.filled_ratio:.1f} % in place, "
        f"{100.0 * end.spill_ratio:.2f} % spilled, unevenness {end.unevenness_m:.2f} m; written to {output}"
    )
    return 0


def report(run: JobPath, /, *, output: Path) -> int:
    """Write the HTML report of a simulated job.

    Example: downrange job report run.json --output report.html

    Args:
        run: JSON file of `downrange job simulate`.
        output: the HTML file to write.
    """
    if not output.resolve().parent.is_dir():
        raise UsageError(f"cannot write {output}: the folder {output.parent} does not exist")
    try:
        content: dict[str, Any] = json_text.loads(run.read_text(encoding="utf-8"))
        page = job_html(content)
    except OSError as error:
        raise UsageError(f"{run} cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise UsageError(f"{run} is not the result of `downrange job simulate`: {error}") from error
    output.write_text(page, encoding="utf-8")
    print(f"written to {output}")
    return 0


def _planner(job: BulkJob, models: Sequence[ThrowModel]) -> LoadPlanner:
    return LoadPlanner(job.goal, job.field, models, job.file.grab_m3, job.file.zones)


def _models(job: BulkJob, policies: Path, policy: Path | None) -> tuple[ThrowModel, ...]:
    """The machine's throws: with the scatter of the job file, else with that of virtual machines."""
    spec, file = load_spec(), job.file
    among = open_policies(policies, policy, None if file.mode is None else Mode(file.mode))
    height_m = middle_height_m(job)
    if not file.landing:
        return previewed_models(among, spec, job.material, height_m, file.grab_m3, file.pace_ratio)
    scatter = [LandingScatter(**item.model_dump()) for item in file.landing]
    pace = DEFAULT_PACE_RATIO if file.pace_ratio is None else file.pace_ratio
    return tuple(
        measured_model(one.card, spec, job.material, scatter, height_m, file.grab_m3, pace)
        for one in among
    )


ACTIONS = {"plan": plan, "simulate": simulate, "report": report}
