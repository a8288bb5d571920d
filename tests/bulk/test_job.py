import io
import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import tifffile

from bulk.job_file import read_job
from bulk.job_report import contour_lines
from bulk.survey import parse_survey, read_survey
from cli.main import main
from machine.errors import UsageError
from tests.cases import each

POLICIES = str(Path(__file__).parents[2] / "policies")
JOB: dict[str, Any] = {
    "name": "small <truck>",
    "mode": "2d",
    "material": "gravel",
    "grab_m3": 0.3,
    "area": {"x_min_m": 6.0, "x_max_m": 10.0, "y_min_m": -2.0, "y_max_m": 2.0},
    "containers": [
        {
            "name": "truck",
            "x_m": 8,
            "y_m": 0,
            "length_m": 2,
            "width_m": 1.6,
            "floor_m": 1,
            "wall_m": 0.6,
        }
    ],
    "work": {"kind": "truck", "container": "truck"},
    "landing": [{"range_m": 8.0, "sd_downrange_m": 0.06, "sd_crossrange_m": 0.04}],
}


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "job.json"
    path.write_text(json.dumps({**JOB, **changes}), encoding="utf-8")
    return path


def grid_csv(folder: Path, z: str = "0.0", skip: int | None = None, scale: float = 1.0) -> Path:
    path = folder / "survey.csv"
    lines = [
        f"{scale * (6.0 + 0.5 * i)},{scale * (0.5 * j)},{z}" for j in range(-4, 5) for i in range(9)
    ]
    if skip is not None:
        del lines[skip]
    path.write_text("x_m,y_m,z_m\n" + "\n".join(lines), encoding="utf-8")
    return path


def test_a_job_is_planned_simulated_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    job, run, page = written(tmp_path), tmp_path / "run.json", tmp_path / "report.html"
    assert main(["job", "plan", str(job), "--json", "--policies", POLICIES]) == 0
    planned = json.loads(capsys.readouterr().out)
    assert len(planned["loads"]) == 3
    assert "spill risk" in planned["loads"][0]["sentence"]
    options = ["--loads", "3", "--repose-ratio", "0.9", "--policies", POLICIES]
    assert main(["job", "simulate", str(job), "--output", str(run), *options]) == 0
    content = json.loads(run.read_text(encoding="utf-8"))
    assert len(content["loads"]) == 3
    assert abs(content["balance_m3"]) < 1e-9
    assert main(["job", "report", str(run), "--output", str(page)]) == 0
    html = page.read_text(encoding="utf-8")
    assert "small &lt;truck&gt;" in html and html.count("<svg") == 4
    run.write_text("{}", encoding="utf-8")
    assert main(["job", "report", str(run), "--output", str(page)]) == 1
    assert "not the result" in capsys.readouterr().err


def test_contour_lines_leave_walls_out():
    x_m = np.arange(0.0, 4.0, 0.1)
    height = np.where(x_m > 2.0, 0.6, 0.0) + np.where(x_m < 1.0, 0.4 * (1.0 - x_m), 0.0)
    surface = np.tile(height, (5, 1))
    lines = contour_lines(x_m, x_m[:5], surface, 0.1, 2.2)
    assert lines[:, :, 0] == pytest.approx(0.75)
    assert len(contour_lines(x_m, x_m[:5], surface, 0.1)) == 2 * len(lines), "with the wall's"


@each(
    "changes, words",
    [
        ({"material": "cheese"}, "there are basketball"),
        ({"grab_m3": 0.0}, "grab_m3"),
        ({"area": None}, "either area or survey"),
        ({"work": {"kind": "truck", "container": "box"}}, "there are: truck"),
        ({"work": {"kind": "truck", "container": "truck", "fill_ratio": 1e-6}}, "m3 only"),
        (
            {"work": {"kind": "pile", "height_m": 1,
                      "foot": {"x_m": 9.5, "y_m": 0, "length_m": 2, "width_m": 1}}},
            r"x 10\.5 m, y -0\.5 m",
        ),
        (
            {"work": {"kind": "clear", "container": "truck",
                      "heap": {"x_m": 6.5, "y_m": 0, "length_m": 0.5, "width_m": 1}}},
            r"holds 0\.000 m3",
        ),
        ({"survey": "none.csv", "area": None}, "cannot be read"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_refused(changes: dict[str, Any], words: str, tmp_path: Path):
    with pytest.raises(UsageError, match=words):
        read_job(written(tmp_path, **changes))


def test_a_truck_out_of_reach_ends_with_its_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    high = [{**JOB["containers"][0], "floor_m": 3.5}]
    job = written(tmp_path, containers=high)
    assert main(["job", "plan", str(job), "--policies", POLICIES]) == 1
    assert "heights of -1.0 to 3.0 m" in capsys.readouterr().err


def test_a_survey_is_a_grid_or_a_cloud(tmp_path: Path):
    grid, height = read_survey(grid_csv(tmp_path, "0.25"), 0.5)
    assert height.shape == (9, 9) and (height == 0.25).all()
    fine, height = read_survey(grid_csv(tmp_path, "0.25"), 0.2)
    assert height.shape == (21, 21) and height == pytest.approx(0.25), "a coarse grid is filled in"
    assert (fine.x0_m, fine.y0_m) == (6.0, -2.0)
    path = grid_csv(tmp_path, "0.25")
    path.write_text(path.read_text() + "\n6.1,-2.1,0.35\n6.0,-2.0,9.0\n", encoding="utf-8")
    grid, height = read_survey(path, 0.5)
    assert grid.y0_m == pytest.approx(-2.1)
    assert height[0, 0] == pytest.approx(0.35), "the median of a cell's points"


SLOPE_X_M = 6.0 + 0.2 * (np.arange(20) + 0.5)
SLOPE_Y_M = -2.0 + 0.2 * (np.arange(20) + 0.5)
SLOPE_M = 0.1 * SLOPE_X_M[None, :] - 0.05 * SLOPE_Y_M[:, None]


def tiff(
    *, x_m: float = 6.0, holes: int = 0, keys: tuple[int, ...] = (), has_scale: bool = True,
    end: int | None = None, cell_m: float = 0.2, **options: Any,
) -> bytes:  # fmt: skip
    """A GeoTIFF of a slope, its first row in the north."""
    height = SLOPE_M[::-1].astype(np.float32)
    height[3, :holes] = -9999.0
    directory = (1, 1, 0, len(keys) // 2, *(
        value for key, number in zip(keys[::2], keys[1::2], strict=True) for value in (key, 0, 1, number)
    ))  # fmt: skip
    tags = [
        (33550 if has_scale else 65000, "d", 3, (cell_m, 0.2, 0.0), True),
        (33922, "d", 6, (0.0, 0.0, 0.0, x_m, 2.0, 0.0), True),
        (34735, "H", len(directory), directory, True),
        (42113, "s", 0, "-9999", True),
    ]
    file = io.BytesIO()
    tifffile.imwrite(file, height, extratags=tags, **options)
    return file.getvalue()[:end]


def las(
    *, scale: float = 1.0, wkt: str = "", is_packed: bool = True, end: int | None = None,
    header: tuple[str, int, float] | None = None,
) -> bytes:  # fmt: skip
    """A point cloud of the same slope, sixteen points a cell; a field of its header may be another."""
    x, y = (
        axis.ravel() for axis in np.meshgrid(np.arange(6.0, 10.0, 0.05), np.arange(-2.0, 2.0, 0.05))
    )
    cloud: Any = laspy.create(point_format=6, file_version="1.4")
    cloud.header.scales = [0.001 * scale] * 3
    z = 0.1 * x - 0.05 * y
    classes = np.zeros(len(x), dtype=np.uint8)
    z[::7], classes[::7] = 30.0, 7
    cloud.x, cloud.y, cloud.z, cloud.classification = scale * x, scale * y, scale * z, classes
    if wkt:
        cloud.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    file = io.BytesIO()
    cloud.write(file, do_compress=is_packed)
    content = bytearray(file.getvalue()[:end])
    if header is not None:
        struct.pack_into(*header[:1], content, *header[1:])
    return bytes(content)


@each(
    "make, options, cell_m",
    [
        (tiff, {}, 0.2),
        (tiff, {}, 0.1),
        (tiff, {}, 0.4),
        (tiff, {"compression": "zlib"}, 0.2),
        (tiff, {"keys": (1024, 1, 3076, 9001)}, 0.2),
        (las, {}, 0.2),
        (las, {"is_packed": False}, 0.2),
        (las, {"wkt": 'PROJCS["x",GEOGCS["y",UNIT["degree",0.0174]],UNIT["metre",1]]'}, 0.2),
    ],
)
def test_a_survey_is_a_geotiff_or_the_point_cloud_of_a_scanner(
    make: Callable[..., bytes], options: dict[str, Any], cell_m: float
):
    grid, height = parse_survey(make(**options), "the survey", cell_m)
    wanted = 0.1 * grid.x_m[None, :] - 0.05 * grid.y_m[:, None]
    assert height.shape[0] * cell_m == pytest.approx(4.0, abs=cell_m + 0.01)
    assert np.abs(height - wanted).max() < 0.021


@each(
    "make, options, words",
    [
        (tiff, {"x_m": 500_006.0}, "reaches 500010 m from the machine"),
        (tiff, {"keys": (1024, 2)}, "is in degrees"),
        (tiff, {"keys": (1024, 1, 3076, 9002)}, "x and y in the unit EPSG:9002, not in metres"),
        (tiff, {"keys": (4099, 9003)}, "z in the unit EPSG:9003"),
        (tiff, {"holes": 4}, r"in 4 of 400 cells of 0\.2 m, the first at x 6\.10 m, y 1\.30 m"),
        (tiff, {"end": 700}, "cannot be read"),
        (tiff, {"has_scale": False}, "does not say where it lies"),
        (tiff, {"cell_m": math.nan}, "sizes are above 0"),
        (tiff, {"cell_m": -0.2}, "sizes are above 0"),
        (tiff, {"cell_m": math.inf}, "not finite"),
        (tiff, {"x_m": math.nan}, "not finite"),
        (las, {"header": ("<d", 131, math.nan)}, "not finite"),
        (las, {"header": ("<d", 155, math.inf)}, "not finite"),
        (las, {"header": ("<I", 100, 2**32 - 1)}, "4294967295 records"),
        (las, {"header": ("<I", 243, 2**32 - 1)}, "4294967295 records"),
        (las, {"header": ("<Q", 247, 10**9)}, "1000000000 points"),
        (las, {"scale": 1000.0}, "millimetres"),
        (las, {"wkt": 'PROJCS["x",UNIT["US survey foot",0.3048006]]'}, "unit US survey foot"),
        (las, {"wkt": 'GEOGCS["y",UNIT["degree",0.0174]]'}, "is in degrees"),
        (las, {"end": 3000}, "cannot be read"),
        (lambda: b"\xff\xd8\xff a photo", {}, "is no CSV text, GeoTIFF, LAS or LAZ"),
        (lambda: "\ufffd\ufffd\n".encode(), {}, "is no CSV text, GeoTIFF, LAS or LAZ"),
        (lambda: b"\n", {}, "is empty"),
    ],
)
def test_a_survey_in_other_units_or_another_frame_is_refused(
    make: Callable[..., bytes], options: dict[str, Any], words: str
):
    with pytest.raises(UsageError, match=words):
        parse_survey(make(**options), "the survey", 0.2)


@each(
    "options, words",
    [
        ({"skip": 10}, r"no point in 1 of 81 cells of 0\.5 m, the first at x 6\.50 m, y -1\.50 m"),
        ({"scale": 1000.0}, "millimetres"),
        ({"z": "400.0"}, "at most 50 m"),
        ({"z": "high"}, "line 2"),
        ({"z": "nan"}, "not finite"),
    ],
)
def test_bad_surveys_are_refused(options: dict[str, Any], words: str, tmp_path: Path):
    with pytest.raises(UsageError, match=words):
        read_survey(grid_csv(tmp_path, **options), 0.5)
