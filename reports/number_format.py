"""Numbers as people read them: fixed digits, a true minus sign, a unit, a word for the sign of an error."""

import math

MINUS = "−"
NONE = "–"
"""Shown for what is not known."""
PERFECT_HIT_M = 0.005
"""Smaller errors round to 0.00 m."""


def fixed(value: float | None, digits: int = 2) -> str:
    """Fixed digits with a true minus sign and without "-0.00"; a dash for what is not known."""
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{abs(value):.{digits}f}"
    return MINUS + text if value < 0 and float(text) != 0.0 else text


def metres(value: float | None, digits: int = 2) -> str:
    """A length in metres."""
    return NONE if value is None or not math.isfinite(value) else f"{fixed(value, digits)} m"


def percent(ratio: float | None, digits: int = 0) -> str:
    """A ratio in percent."""
    if ratio is None or not math.isfinite(ratio):
        return NONE
    return f"{fixed(100.0 * ratio, digits)} %"


def probability(value: float) -> str:
    """A probability in percent; never 0 % or 100 %."""
    if value > 0.995:
        return "> 99 %"
    return "< 1 %" if value < 0.005 else percent(value)


def downrange(error_m: float) -> str:
    """Error along the target line: "+0.12 m long"."""
    return _error(error_m, "long", "short", "on range")


def crossrange(error_m: float) -> str:
    """Error across it, left positive as in frame `throw`: "+0.05 m left"."""
    return _error(error_m, "left", "right", "on line")


def _error(error_m: float, positive: str, negative: str, zero: str) -> str:
    if not math.isfinite(error_m):
        return NONE
    if abs(error_m) < PERFECT_HIT_M:
        return f"0.00 m {zero}"
    return f"{'+' if error_m > 0.0 else ''}{fixed(error_m)} m {positive if error_m > 0.0 else negative}"
