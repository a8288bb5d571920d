"""Plan and course of a job as JSON and as one HTML page."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from bulk.goal import Progress
from bulk.height_field import HeightField
from bulk.job_file import BulkJob
from bulk.planner import PlannedLoad
from bulk.simulation import JobRun
from bulk.throw_model import ThrowModel
from machine.conventions import Array
from reports.html import render_page
from reports.svg import Axes, Margins, drawing, round_ticks

MAP_WIDTH = 640.0
SECTION_WIDTH, SECTION_HEIGHT = 480.0, 190.0
MARGINS = Margins(left=46.0, right=8.0, top=8.0, bottom=22.0)
CONTOUR_COUNT = 8
WALL_SLOPE_RATIO = 2.2
"""Rise over run from which on a side is a wall: the contour lines of all heights would meet there."""


def progress_json(state: Progress) -> dict[str, float]:
    """Progress with its ratios."""
    return {
        **state._asdict(),
        "filled_ratio": state.filled_ratio,
        "spill_ratio": state.spill_ratio,
    }


def load_json(load: PlannedLoad) -> dict[str, Any]:
    """A planned load with its sentence."""
    return {**load._asdict(), "sentence": load.sentence}


def job_json(job: BulkJob, models: Sequence[ThrowModel]) -> dict[str, Any]:
    """What job and machine are."""
    return {
        "name": job.file.name,
        "goal": job.goal.kind.value,
        "material": job.material.name,
        "policy": " and ".join(sorted({model.card.policy_id for model in models})),
        "grab_m3": job.file.grab_m3,
        "grab_kg": job.material.mass_kg(job.file.grab_m3),
        "landing_is_measured": bool(job.file.landing),
    }


def run_json(job: BulkJob, models: Sequence[ThrowModel], run: JobRun, seed: int) -> dict[str, Any]:
    """Course of a simulated job."""
    start, end = run.start.volume_m3(), run.final.volume_m3()
    dug = run.thrown_m3 if job.goal.heap is not None else 0.0
    return {
        "job": job_json(job, models),
        "seed": seed,
        "progress": progress_json(run.loads[-1].after) if run.loads else None,
        "thrown_m3": run.thrown_m3,
        "thrown_kg": job.material.mass_kg(run.thrown_m3),
        "balance_m3": end - start - run.thrown_m3 + dug,
        "loads": [
            {
                **load_json(item.target),
                "landed_x_m": item.landed_m[0],
                "landed_y_m": item.landed_m[1],
                "thrown_m3": item.volume_m3,
                "after": progress_json(item.after),
            }
            for item in run.loads
        ],
        **surfaces_json(job, run.final),
    }


def surfaces_json(job: BulkJob, final: HeightField) -> dict[str, Any]:
    """Grid and surfaces of a job, heights (rows, columns) to 0.1 mm."""
    return {
        "grid": final.grid._asdict(),
        "base_m": np.round(final.base_m, 4).tolist(),
        "start_m": np.round(job.field.height_m, 4).tolist(),
        "wanted_m": np.round(job.goal.wanted_m, 4).tolist(),
        "height_m": np.round(final.height_m, 4).tolist(),
        "region": job.goal.region.astype(int).tolist(),
    }


def job_html(content: dict[str, Any]) -> str:
    """The page of a job, from its JSON: simulated (`run_json`), or thrown, which has no `seed`.

    Raises:
        KeyError, TypeError, ValueError: not such content.
    """
    grid = content["grid"]
    arrays = {name: np.asarray(content[name], dtype=np.float64) for name in
              ("base_m", "start_m", "wanted_m", "height_m")}  # fmt: skip
    region = np.asarray(content["region"], dtype=bool)
    shape = (int(grid["row_count"]), int(grid["column_count"]))
    if any(array.shape != shape for array in (*arrays.values(), region)):
        raise ValueError("its surfaces have other sizes than its grid")
    x_m = grid["x0_m"] + grid["cell_m"] * np.arange(shape[1])
    y_m = grid["y0_m"] + grid["cell_m"] * np.arange(shape[0])
    loads = content["loads"]
    return render_page(
        Path(__file__).parent,
        "job.html.j2",
        job=content["job"],
        state=content["progress"],
        content=content,
        loads=loads,
        map=surface_map(x_m, y_m, arrays["height_m"], region, loads),
        sections=sections(x_m, y_m, arrays, region),
        course=course(loads) if loads else None,
    )


def surface_map(
    x_m: Array, y_m: Array, height_m: Array, region: Any, loads: Sequence[dict[str, Any]]
) -> Markup:
    """Contour lines of the surface, the goal's region and the targets, seen from above."""
    rows, columns = np.nonzero(region)
    margin = 1.5
    x = (float(x_m[columns].min()) - margin, float(x_m[columns].max()) + margin)
    y = (float(y_m[rows].min()) - margin, float(y_m[rows].max()) + margin)
    height = MAP_WIDTH * (y[1] - y[0]) / (x[1] - x[0])
    axes = Axes(x, y, MAP_WIDTH, height, MARGINS)
    parts = [axes.x_tick(value) for value in round_ticks(*x, 6)]
    parts += [axes.y_tick(value) for value in round_ticks(*y, 5)]
    near_x, near_y = (x_m >= x[0]) & (x_m <= x[1]), (y_m >= y[0]) & (y_m <= y[1])
    part = height_m[np.ix_(near_y, near_x)]
    low, high = float(part.min()), float(part.max())
    goal = np.asarray(region, dtype=np.float64)[np.ix_(near_y, near_x)]
    for line in contour_lines(x_m[near_x], y_m[near_y], goal, 0.5).tolist():
        parts.append(axes.path("other", line))
    for level in round_ticks(low, high, CONTOUR_COUNT) if high - low > 0.05 else []:
        lines = contour_lines(x_m[near_x], y_m[near_y], part, level + 1e-6, WALL_SLOPE_RATIO)
        parts += [axes.path("after", line) for line in lines.tolist()]
    parts.append(axes.dots("dot target", [(item["x_m"], item["y_m"]) for item in loads], 3.0))
    return drawing(MAP_WIDTH, height, "surface from above with contour lines and targets", parts)


def contour_lines(
    x_m: Array, y_m: Array, height_m: Array, level_m: float, steepest_ratio: float = math.inf
) -> Array:
    """(N, 2, 2) segments of the line at a level; every square of the grid is cut into two triangles.

    Triangles whose heights differ by more than a slope (over the width of a cell) are left out.
    """
    x, y = np.meshgrid(x_m, y_m)
    corner = np.stack([x, y, height_m], axis=-1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    triangles = np.concatenate(
        [
            np.stack([a, b, c], axis=2).reshape(-1, 3, 3),
            np.stack([a, c, d], axis=2).reshape(-1, 3, 3),
        ]
    )
    above = triangles[:, :, 2] > level_m
    rise = np.ptp(triangles[:, :, 2], axis=1)
    is_wall = rise > steepest_ratio * (x_m[1] - x_m[0])
    cut = triangles[above.any(axis=1) & ~above.all(axis=1) & ~is_wall]
    high = cut[:, :, 2] > level_m
    # The corner that is alone on its side; the line crosses both of its edges.
    alone = np.where(high.sum(axis=1) == 1, high.argmax(axis=1), (~high).argmax(axis=1))
    index = np.arange(len(cut))
    single = cut[index, alone]
    ends = [cut[index, (alone + shift) % 3] for shift in (1, 2)]
    points = [
        single[:, :2]
        + ((level_m - single[:, 2]) / (end[:, 2] - single[:, 2]))[:, None] * (end - single)[:, :2]
        for end in ends
    ]
    return np.stack(points, axis=1)


def sections(x_m: Array, y_m: Array, arrays: dict[str, Array], region: Any) -> list[Markup]:
    """Sections through the middle of the region, along x and along y."""
    rows, columns = np.nonzero(region)
    row, column = int(np.median(rows)), int(np.median(columns))
    pick = {
        "x": (x_m, {name: array[row] for name, array in arrays.items()}),
        "y": (y_m, {name: array[:, column] for name, array in arrays.items()}),
    }
    drawn: list[Markup] = []
    for name, (along, lines) in pick.items():
        used = columns if name == "x" else rows
        near = slice(max(int(used.min()) - 15, 0), int(used.max()) + 16)
        all_values = np.concatenate([line[near] for line in lines.values()])
        low, high = float(all_values.min()) - 0.1, float(all_values.max()) + 0.1
        axes = Axes(
            (float(along[near][0]), float(along[near][-1])), (low, high),
            SECTION_WIDTH, SECTION_HEIGHT, MARGINS,
        )  # fmt: skip
        parts = [axes.x_tick(value) for value in round_ticks(*axes.x, 6)]
        parts += [axes.y_tick(value) for value in round_ticks(low, high, 4)]
        for css, key in (("other", "base_m"), ("before", "wanted_m"), ("measured", "height_m")):
            parts.append(axes.path(css, zip(along[near], lines[key][near], strict=True)))
        drawn.append(
            drawing(
                SECTION_WIDTH, SECTION_HEIGHT, f"section along {name}, heights in metres", parts
            )
        )
    return drawn


def course(loads: Sequence[dict[str, Any]]) -> Markup:
    """Filled share and spill over the loads, percent."""
    axes = Axes((0.0, float(len(loads))), (0.0, 100.0), SECTION_WIDTH, SECTION_HEIGHT, MARGINS)
    parts = [axes.x_tick(value) for value in round_ticks(0.0, float(len(loads)), 6)]
    parts += [axes.y_tick(value) for value in (0.0, 25.0, 50.0, 75.0, 100.0)]
    for css, key in (("after", "filled_ratio"), ("before", "spill_ratio")):
        points = [(0.0, 0.0)] + [
            (number, 100.0 * min(max(float(load["after"][key]), 0.0), 1.0))
            for number, load in enumerate(loads, start=1)
        ]
        parts.append(axes.path(css, points))
    return drawing(SECTION_WIDTH, SECTION_HEIGHT, "filled and spilled share over the loads", parts)
