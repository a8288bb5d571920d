"""Simulated jobs with bulk material: the planner against looking one load ahead, greedy and fixed placement.

    python -m benchmarks.bulk_jobs [--count 200] [--jobs 2]

Half of the jobs fill a truck, half build a pile, each with gravel, sand or wood chips. Every rule has the
same stock, the wanted volume of the job, and meets the same truth, which differs from the planner's model:
angle of repose by up to 12 % of its tangent, landing bias with 0.08 m of standard deviation per axis, landing
scatter 0.8 to 1.5 times and footprints 0.7 to 1.4 times as wide as assumed, grabs that differ by 8 %.

Greedy throws full grabs at the place where most is missing under the footprint; fixed throws at three places
along the length in turn. These throw 2D at one pace with the scatter measured there. The last two rules
compare 2D at pace 0 with a free choice of mode and pace, with scatter and footprints of the twin's previews.
Intervals by bootstrap over jobs.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
import tyro

from benchmarks.result_file import Value, describe, percentile, row, write_result
from bulk.footprint import POUR_COUNT
from bulk.goal import Goal, pile_goal, truck_goal
from bulk.height_field import Container, HeightField, Rectangle, level_field, make_grid
from bulk.material import material
from bulk.planner import GRAB_S, LoadPlanner, PlannedLoad
from bulk.previewed_throws import open_policies, previewed_models
from bulk.simulation import JobRun, Rule, Truth, planned_rule, simulate_job
from bulk.throw_model import LandingScatter, ThrowModel, measured_model
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.policy_card import load_card
from machine.spec import load_spec

MATERIALS = ("gravel", "sand", "wood chips")
GOALS = ("truck", "pile")
RULES = ("planner", "one load ahead", "greedy", "fixed", "2D at pace 0", "mode and pace chosen")
GRAB_M3 = 0.25
SCATTER = (
    LandingScatter(7.0, 0.05, 0.04),
    LandingScatter(8.5, 0.07, 0.045),
    LandingScatter(10.0, 0.11, 0.05),
)
"""About that of m545-2d-v7 on the virtual machine (benchmarks/results/policy_accuracy.json)."""
CARD = Path(__file__).parents[1] / "policies" / "m545-2d-v7"
DRAW_COUNT = 4000


class JobResult(NamedTuple):
    """End of one job with one rule."""

    goal: str
    rule: str
    filled_ratio: float
    """Material in the truck over its struck volume; in the pile over the wanted volume."""
    unevenness_m: float
    spill_ratio: float
    load_count: int
    work_s: float
    """With the assumed time of a grab."""
    balance_ratio: float
    """Thrown volume that is not on the field, over the thrown one."""


class Setting(NamedTuple):
    """A drawn job."""

    start: HeightField
    goal: Goal
    throws: ThrowModel
    previewed: tuple[ThrowModel, ...]
    """Both modes at every pace."""
    truth: Truth
    struck_m3: float


def draw(seed: int, index: int) -> Setting:
    """Job number `index`."""
    rng = np.random.default_rng((seed, index))
    kind, stuff = GOALS[index % 2], material(MATERIALS[index // 2 % 3])
    grid = make_grid((1.0, 13.7), (-6.3, 6.4), 0.1)
    range_m, bearing = rng.uniform(7.4, 8.4), rng.uniform(-0.25, 0.25)
    x_m, y_m = range_m * math.cos(bearing), range_m * math.sin(bearing)
    turn = rng.uniform(-math.pi, math.pi)
    truth = Truth(
        slope_ratio=stuff.slope_ratio * rng.uniform(0.88, 1.12),
        bias_m=(float(rng.normal(0.0, 0.08)), float(rng.normal(0.0, 0.08))),
        scatter_ratio=float(rng.uniform(0.8, 1.5)),
        footprint_ratio=float(rng.uniform(0.7, 1.4)),
    )
    if kind == "truck":
        length_m, width_m = rng.uniform(3.4, 4.4), rng.uniform(2.0, 2.4)
        bed = Container("truck", Rectangle(x_m, y_m, length_m, width_m, turn), 1.0, 0.8)
        start = level_field(grid, [bed])
        goal = truck_goal(start, 0, 0.95)
        struck = float(start.inside(0).sum()) * grid.cell_area_m2 * bed.wall_m
        height_m = 1.4
    else:
        start = level_field(grid)
        foot = Rectangle(x_m, y_m, rng.uniform(4.0, 4.8), rng.uniform(3.4, 4.0), turn)
        goal = pile_goal(start, foot, 1.1, stuff.slope_ratio)
        struck = float((goal.wanted_m - start.height_m).sum()) * grid.cell_area_m2
        height_m = 0.5
    throws = measured_model(load_card(CARD), load_spec(), stuff, SCATTER, height_m, GRAB_M3)
    return Setting(start, goal, throws, previewed(stuff.name, height_m), truth, struck)


@cache
def previewed(name: str, height_m: float) -> tuple[ThrowModel, ...]:
    """Throws of the active policies with a material, as the twin previews them."""
    among = open_policies(CARD.parent, None, None)
    return previewed_models(among, load_spec(), material(name), height_m, GRAB_M3)


def models_of(name: str, job: Setting) -> tuple[ThrowModel, ...]:
    """Throws that a rule may choose from."""
    if name == "mode and pace chosen":
        return job.previewed
    if name == "2D at pace 0":
        ways = ((one.card.mode, one.pace_ratio, one) for one in job.previewed)
        return tuple(one for mode, pace, one in ways if (mode, pace) == (Mode.PLANAR, 0.0))
    return (job.throws,)


def chosen(name: str, job: Setting) -> Rule:
    """A rule by name, ending with the job's stock."""
    depth = 1 if name == "one load ahead" else 3
    planner = LoadPlanner(job.goal, job.start, models_of(name, job), GRAB_M3, depth=depth)
    if name == "greedy":
        rule = greedy(planner, job)
    elif name == "fixed":
        rule = fixed(planner, job)
    else:
        rule = planned_rule(planner)
    stock = [float((job.goal.wanted_m - job.start.height_m).sum()) * job.start.grid.cell_area_m2]

    def limited(surface: HeightField, count: int) -> PlannedLoad | None:
        load = rule(surface, count)
        if load is None or stock[0] < 0.5 * load.volume_m3:
            return None
        stock[0] -= load.volume_m3
        return load

    return limited


def greedy(planner: LoadPlanner, job: Setting) -> Rule:
    """Full grabs at the place with most missing volume within a footprint of 0.35 m."""
    grid = job.start.grid
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    near = [np.hypot(x - a, y - b) <= 0.35 for a, b in planner.places_m.tolist()]

    def choose(surface: HeightField, _: int) -> PlannedLoad | None:
        missing = np.where(job.goal.region, job.goal.wanted_m - surface.height_m, 0.0)
        score = np.array([missing[mask].sum() for mask in near])
        score[~planner.reachable(surface.height_m, GRAB_M3)] = -np.inf
        if not score.max() > 0.0:
            return None
        return plain_load(surface, *planner.places_m[int(score.argmax())].tolist())

    return choose


def fixed(planner: LoadPlanner, job: Setting) -> Rule:
    """Full grabs at three places along the length in turn."""
    place = job.goal.place
    marks = [place.point_m(share * place.length_m, 0.0) for share in (-0.28, 0.0, 0.28)]
    cells = planner.places_m
    nearest = [cells[int(np.hypot(*(cells - mark).T).argmin())] for mark in marks]

    def choose(surface: HeightField, count: int) -> PlannedLoad | None:
        return plain_load(surface, *nearest[count % len(nearest)].tolist())

    return choose


def plain_load(surface: HeightField, x_m: float, y_m: float) -> PlannedLoad:
    height_m = surface.surface_m(x_m, y_m) or 0.0
    way = Mode.PLANAR, DEFAULT_PACE_RATIO, ""
    return PlannedLoad(x_m, y_m, height_m, GRAB_M3, 0.0, 0.0, "", 0.0, *way)


def run_one(task: tuple[int, int]) -> list[JobResult]:
    """One job with every rule."""
    seed, index = task
    job = draw(seed, index)
    results: list[JobResult] = []
    for rule in RULES:
        run = simulate_job(
            job.goal, job.start, models_of(rule, job), chosen(rule, job), job.truth,
            np.random.default_rng((seed, index, 1)),
        )  # fmt: skip
        last = run.loads[-1].after
        balance = abs(run.thrown_m3 - run.final.volume_m3() + run.start.volume_m3())
        full = last.placed_m3 / job.struck_m3 if index % 2 == 0 else last.filled_ratio
        results.append(
            JobResult(
                GOALS[index % 2], rule, full, last.unevenness_m, last.spill_ratio,
                len(run.loads), work_s(run, models_of(rule, job)), balance / run.thrown_m3,
            )
        )  # fmt: skip
    return results


def work_s(run: JobRun, models: Sequence[ThrowModel]) -> float:
    """Time of a job's loads."""
    release_s = {(one.card.mode, one.pace_ratio): one.release_s for one in models}
    return sum(GRAB_S + release_s[load.target.mode, load.target.pace_ratio] for load in run.loads)


def mean_value(samples: np.ndarray, rng: np.random.Generator) -> Value:
    drawn = samples[rng.integers(0, samples.size, (DRAW_COUNT, samples.size))].mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Value(value=float(samples.mean()), low=float(low), high=float(high))


def saving(ours: np.ndarray, others: np.ndarray, rng: np.random.Generator) -> Value:
    """1 - mean(ours) / mean(others), jobs drawn together."""
    if not others.sum() > 0.0:
        return Value(value=None)
    drawn = rng.integers(0, ours.size, (DRAW_COUNT, ours.size))
    ratio = 1.0 - ours[drawn].mean(axis=1) / np.maximum(others[drawn].mean(axis=1), 1e-12)
    low, high = np.percentile(ratio, [2.5, 97.5])
    return Value(value=float(1.0 - ours.mean() / others.mean()), low=float(low), high=float(high))


def job_rows(results: list[list[JobResult]]) -> list[object]:
    rng = np.random.default_rng(0)
    rows: list[object] = []
    for goal in GOALS:
        of = {
            rule: [
                item for job in results for item in job if (item.goal, item.rule) == (goal, rule)
            ]
            for rule in RULES
        }

        def column(rule: str, name: str, of: dict[str, list[JobResult]] = of) -> np.ndarray:
            return np.array([getattr(item, name) for item in of[rule]])

        for rule in RULES:
            values = {
                "filled_median_ratio": percentile(column(rule, "filled_ratio"), 50.0),
                "spill_median_ratio": percentile(column(rule, "spill_ratio"), 50.0),
                "spill_mean_ratio": mean_value(column(rule, "spill_ratio"), rng),
                "unevenness_mean_m": mean_value(column(rule, "unevenness_m"), rng),
                "load_count": mean_value(column(rule, "load_count"), rng),
                "work_s": mean_value(column(rule, "work_s"), rng),
                "balance_largest_ratio": float(column(rule, "balance_ratio").max()),
            }
            for name in ("spill_ratio", "unevenness_m"):
                label = f"planner_less_{name.removesuffix('_m')}"
                values[f"{label.removesuffix('_ratio')}_ratio"] = (
                    None
                    if rule == "planner"
                    else saving(column("planner", name), column(rule, name), rng)
                )
            rows.append(row(len(of[rule]), {"goal": goal, "rule": rule}, values))
    return rows


def speed_rows(repeats: int = 60) -> list[object]:
    """Milliseconds of a pour on a used surface of 128 x 128 cells and of a plan of three loads."""
    job = draw(0, 0)
    planner = LoadPlanner(job.goal, job.start, [job.throws], GRAB_M3)
    chooser = LoadPlanner(job.goal, job.start, job.previewed, GRAB_M3)
    rng, surface = np.random.default_rng(1), job.start
    pours: list[float] = []
    plans: list[float] = []
    choices: list[float] = []
    points = planner.places_m
    for _ in range(repeats):
        centre = points[rng.integers(len(points))]
        grains = centre + rng.normal(0.0, 0.25, (POUR_COUNT, 2))
        began = perf_counter()
        after = surface.pour(grains, GRAB_M3 / POUR_COUNT, job.truth.slope_ratio)
        pours.append(1e3 * (perf_counter() - began))
        surface = after
    for _ in range(repeats // 3):
        began = perf_counter()
        planner.next_loads(job.start)
        plans.append(1e3 * (perf_counter() - began))
        began = perf_counter()
        chooser.next_loads(job.start)
        choices.append(1e3 * (perf_counter() - began))
    return [
        row(
            len(times),
            {"operation": name},
            {"median_ms": percentile(times, 50.0), "p95_ms": percentile(times, 95.0)},
        )
        for name, times in (
            ("pour of one load, 128 x 128 cells", pours),
            ("plan of 3 loads, 200 candidates each", plans),
            ("the same, each at the best of 2 modes and 2 paces", choices),
        )
    ]  # fmt: skip


def main(count: int = 200, jobs: int = 2, seed: int = 42) -> None:
    """Measure and write both result files.

    Args:
        count: jobs.
        jobs: processes.
        seed: of the jobs.
    """
    speed = speed_rows()
    tasks = [(seed, index) for index in range(count)]
    with ProcessPoolExecutor(jobs) as pool:
        results = list(pool.map(run_one, tasks, chunksize=4))
    for result in (
        describe("bulk_speed", "Time of pouring and planning", speed, seed=None),
        describe("bulk_jobs", "Simulated jobs with bulk material", job_rows(results), seed=seed),
    ):
        print(write_result(result))


if __name__ == "__main__":
    tyro.cli(main)
