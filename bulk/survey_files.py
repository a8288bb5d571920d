"""Surveys as GeoTIFF, LAS or LAZ: their points or cells, after a check of frame and units.

Coordinates are those of frame `machine`: a file in degrees, in feet, or in a national grid is refused.
GeoTIFF 1.1 (OGC 19-008r4); LAS 1.4 (ASPRS), whose coordinate system is given by the same keys or as WKT.
"""

import io
import re
from typing import Any, Final, NamedTuple

import numpy as np

from machine.conventions import Array
from machine.errors import UsageError

TIFF_STARTS: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
LAS_START: Final = b"LASF"
SCALE_TAG: Final = 33550
TIEPOINT_TAG: Final = 33922
KEYS_TAG: Final = 34735
"""GeoKeyDirectory; also the number of the record in LAS files."""
NO_DATA_TAG: Final = 42113
"""GDAL's tag for the value of cells without a measurement."""
WKT_RECORD: Final = 2112
RECORD_COUNTS: Final = ((100, 54, 227), (243, 60, 375))
"""Of variable length records and of extended ones (LAS 1.4): place of their number in the header, bytes of
each record's own header, and the least size of a file header that has it."""
METRE: Final = 9001
"""EPSG code of the unit."""
GEOGRAPHIC: Final = 2
"""GTModelTypeGeoKey of coordinates in degrees."""
PIXEL_IS_POINT: Final = 2
NOISE_CLASSES: Final = (7, 18)
UNIT_KEYS: Final = {"x and y": 3076, "z": 4099}
"""ProjLinearUnitsGeoKey and VerticalUnitsGeoKey."""
MODEL_KEY: Final = 1024
RASTER_TYPE_KEY: Final = 1025
_WKT_UNIT = re.compile(r'(?:LENGTH)?UNIT\s*\[\s*"([^"]+)"\s*,\s*([0-9.eE+-]+)', re.IGNORECASE)


class Raster(NamedTuple):
    """Heights on a regular grid, frame `machine`."""

    x_m: Array
    """(columns) increasing."""
    y_m: Array
    """(rows) increasing."""
    z_m: Array
    """(rows, columns); NaN where nothing was measured."""


def is_survey_file(content: bytes) -> bool:
    """Whether a file is none of text."""
    return content.startswith((*TIFF_STARTS, LAS_START))


def read_survey_file(content: bytes, name: str, max_count: int) -> Raster | Array:
    """A raster, or points (N, 3), of a GeoTIFF, LAS or LAZ file.

    Args:
        content: of the file.
        name: what people call it.
        max_count: of cells or points.

    Raises:
        UsageError: it cannot be read, has other units or another frame, or too many points.
    """
    read = _las_points if content.startswith(LAS_START) else _tiff_raster
    try:
        return read(content, name, max_count)
    except UsageError:
        raise
    except Exception as error:  # each library has its own errors for a file that is damaged
        raise UsageError(f"{name} cannot be read: {str(error)[:200]}") from error


def _las_points(content: bytes, name: str, max_count: int) -> Array:
    # Imported here: few surveys are of this kind, and processes start often.
    import laspy

    _require_records(name, content)
    with laspy.open(io.BytesIO(content)) as file:
        header: Any = file.header
        _require_count(name, int(header.point_count), max_count)
        for record in [*header.vlrs, *(header.evlrs or ())]:
            if record.record_id == KEYS_TAG:
                values = np.frombuffer(record.record_data_bytes(), "<u2").reshape(-1, 4)[1:]
                _require_metres(name, {int(key): int(value) for key, _, _, value in values})
            elif record.record_id == WKT_RECORD:
                _require_metres_in_wkt(
                    name, record.record_data_bytes().decode("utf-8", errors="replace")
                )
        points: Any = file.read()
    kept = ~np.isin(np.asarray(points.classification), NOISE_CLASSES)
    found = np.stack([np.asarray(points.x), np.asarray(points.y), np.asarray(points.z)], axis=-1)
    return found[kept].astype(np.float64)


def _tiff_raster(content: bytes, name: str, max_count: int) -> Raster:
    import tifffile

    with tifffile.TiffFile(io.BytesIO(content)) as file:
        page: Any = file.pages[0]
        if len(page.shape) != 2:
            raise UsageError(
                f"{name} has an image of {' x '.join(map(str, page.shape))}, not one band of heights"
            )
        _require_count(name, page.shape[0] * page.shape[1], max_count)
        tags: dict[int, Any] = {tag.code: tag.value for tag in page.tags}
        if SCALE_TAG not in tags or TIEPOINT_TAG not in tags:
            raise UsageError(
                f"{name} does not say where it lies (tags ModelPixelScale and ModelTiepoint); export it as "
                "a north-up GeoTIFF, x forward and y to the left of the slew axis"
            )
        keys = np.asarray(tags.get(KEYS_TAG, ()), dtype=np.int64).reshape(-1, 4)[1:]
        known = {int(key): int(value) for key, _, _, value in keys}
        _require_metres(name, known)
        try:
            height = np.asarray(page.asarray(), dtype=np.float64)
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            raise UsageError(
                f"{name} is compressed as {page.compression.name}; save it uncompressed or with DEFLATE"
            ) from error
    nothing = tags.get(NO_DATA_TAG)
    if nothing is not None:
        height[height == float(str(nothing).strip("\0 "))] = np.nan
    (column, row, _, x_m, y_m, _), (dx_m, dy_m) = tags[TIEPOINT_TAG][:6], tags[SCALE_TAG][:2]
    if not (dx_m > 0.0 and dy_m > 0.0):
        raise UsageError(f"{name} has cells of {dx_m:g} m x {dy_m:g} m; their sizes are above 0")
    middle = 0.0 if known.get(RASTER_TYPE_KEY) == PIXEL_IS_POINT else 0.5
    x = x_m + (np.arange(height.shape[1]) + middle - column) * dx_m
    # Rows run from north to south.
    y = y_m - (np.arange(height.shape[0]) + middle - row) * dy_m
    return Raster(x, y[::-1].copy(), height[::-1].copy())


def _require_records(name: str, content: bytes) -> None:
    """Refuse more variable length records than the file has room for: the library reads on at its end."""
    for place, head_bytes, since_bytes in RECORD_COUNTS:
        if len(content) < since_bytes or int.from_bytes(content[94:96], "little") < since_bytes:
            continue
        count = int.from_bytes(content[place : place + 4], "little")
        if count * head_bytes > len(content):
            raise UsageError(f"{name} declares {count} records, more than its bytes hold")


def _require_count(name: str, count: int, max_count: int) -> None:
    if count > max_count:
        raise UsageError(f"{name} has {count} points, at most {max_count} are taken; thin it out")


def _require_metres(name: str, keys: dict[int, int]) -> None:
    """Refuse a coordinate system (GeoTIFF keys by number) that is not in metres."""
    if keys.get(MODEL_KEY) == GEOGRAPHIC:
        raise UsageError(_in_degrees(name))
    for axes, key in UNIT_KEYS.items():
        if keys.get(key, METRE) != METRE:
            raise UsageError(
                f"{name} has {axes} in the unit EPSG:{keys[key]}, not in metres (EPSG:{METRE}); convert it"
            )


def _require_metres_in_wkt(name: str, wkt: str) -> None:
    if re.search(r"\b(GEOGCS|GEOGCRS|GEODCRS)\b", wkt) and not re.search(
        r"\b(PROJCS|PROJCRS)\b", wkt
    ):
        raise UsageError(_in_degrees(name))
    for unit, factor in _WKT_UNIT.findall(wkt):
        is_angle = re.match("degree|radian|grad", unit, re.IGNORECASE)
        if not is_angle and float(factor) != 1.0:
            raise UsageError(f"{name} is in the unit {unit}, not in metres; convert it")


def _in_degrees(name: str) -> str:
    return f"{name} is in degrees; give metres from the slew axis, x forward and y to the left"
