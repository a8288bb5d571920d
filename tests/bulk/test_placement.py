import numpy as np
import pytest

from bulk.job_file import JobFile, surveyed_job
from bulk.placement import LandedLoad, LoadPlacement
from machine.spec import load_spec

FILE = JobFile.model_validate(
    {
        "name": "yard",
        "material": "gravel",
        "grab_m3": 0.3,
        "area": {"x_min_m": 4.0, "x_max_m": 12.0, "y_min_m": -4.0, "y_max_m": 4.0},
        "work": {
            "kind": "pile",
            "foot": {"x_m": 8, "y_m": 0, "length_m": 4, "width_m": 4},
            "height_m": 1.0,
        },
    }
)


def test_a_measured_load_lies_with_its_centre_spread_and_volume():
    job = surveyed_job(FILE, None)
    placement = LoadPlacement(job, load_spec())
    grid = job.field.grid
    spreads = []
    for scale in (1.0, 4.0):
        load = LandedLoad(8.0, 0.5, 0.3, (0.16 * scale, 0.05 * scale, 0.04 * scale))
        field = placement.place(job.field, load, 1)
        rise = field.height_m - job.field.height_m
        assert rise.sum() * grid.cell_area_m2 == pytest.approx(0.3, rel=1e-9)
        share = rise / rise.sum()
        x, y = np.meshgrid(grid.x_m, grid.y_m)
        centre = float((share * x).sum()), float((share * y).sum())
        assert centre == pytest.approx((8.0, 0.5), abs=0.03)
        dx, dy = x - centre[0], y - centre[1]
        spreads.append([float((share * part).sum()) for part in (dx * dx, dx * dy, dy * dy)])
    # A poured cone widens it by the same in both directions and both cases.
    (xx, xy, yy), (wide_xx, wide_xy, wide_yy) = spreads
    assert xx - yy == pytest.approx(0.12, abs=0.04) and xy == pytest.approx(0.05, abs=0.02)
    assert wide_xx - wide_yy == pytest.approx(0.48, abs=0.08)
    assert wide_xy == pytest.approx(0.2, abs=0.04)
