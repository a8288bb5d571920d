"""Landing errors: a point in frame `machine` to downrange and crossrange errors, and back. All in m."""

import math

from machine.messages import Target


def errors_of(target: Target, x_m: float, y_m: float) -> tuple[float, float]:
    """Downrange and crossrange (left positive) error of a point, frame `machine` -> frame `throw`."""
    range_m = math.hypot(target.x_m, target.y_m)
    cos, sin = _direction(target, range_m)
    return cos * x_m + sin * y_m - range_m, cos * y_m - sin * x_m


def point_of(target: Target, downrange_m: float, crossrange_m: float) -> tuple[float, float]:
    """The point in frame `machine` that has these errors."""
    range_m = math.hypot(target.x_m, target.y_m)
    cos, sin = _direction(target, range_m)
    along_m = range_m + downrange_m
    return cos * along_m - sin * crossrange_m, sin * along_m + cos * crossrange_m


def _direction(target: Target, range_m: float) -> tuple[float, float]:
    return (target.x_m / range_m, target.y_m / range_m) if range_m > 0.0 else (1.0, 0.0)
