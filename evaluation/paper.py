"""Accuracy that the paper reports, for comparison; section numbers are the paper's."""

from typing import NamedTuple


class PaperScatter(NamedTuple):
    """Real throws at 9 m, 10 a policy (IV-B); frame `throw`, crossrange positive to the left."""

    mean_range_m: float
    sd_downrange_m: float
    mean_crossrange_m: float
    sd_crossrange_m: float
    throw_count: int


SCATTER_RANGE_M = 9.0
SCATTER = {
    "2d": PaperScatter(8.92, 0.37, 0.05, 0.30, 10),
    "3d": PaperScatter(8.90, 0.42, -0.14, 0.72, 10),
}
TARGETS = {"2d": "7.5,8,8.5,9,9.5,10,10.5,10.87", "3d": "7,7.5,8,8.5,9,9.5,10,10.5,10.87"}
"""Ranges of the two plots (IV-A: 7.5 to 10 m and 7 to 9.5 m, 200 throws each), extended to 1.45 times the
static reach."""
SIMULATED = {
    "2d": "1 sigma of 0.11 to 0.15 m at the three near targets, good to 9.5 m",
    "3d": "1 sigma of about 0.30 m in both directions at all targets; offset up to 8.0 m",
}
"""Quoted from the text; the numbers of the plots are not printed."""
