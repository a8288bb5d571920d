"""The accuracy report as one HTML page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from evaluation.accuracy_report.accuracy_drawings import (
    landing_plot,
    pace_plot,
    range_plot,
    sensitivity_plot,
    spread_plot,
)
from evaluation.accuracy_report.error_budget import (
    ablation_conclusion,
    error_budget,
    spread_ratios,
)
from evaluation.measures import ModeEvaluation, TargetRow
from evaluation.paper import SCATTER, SCATTER_RANGE_M, SIMULATED
from evaluation.requirements import (
    MAX_SPREAD_RATIO,
    MIN_THROW_COUNT,
    REQUIREMENTS,
    check_requirements,
    requirement_at,
    unmet_fields,
)
from evaluation.sensitivity import CONFIDENCE_RATIO
from reports.html import render_page
from reports.number_format import MINUS
from sim_twin.confidence_intervals import Interval, proportion_interval


def accuracy_html(parts: Sequence[ModeEvaluation], reach_m: float) -> str:
    """The page.

    Args:
        parts: one or both modes.
        reach_m: static reach of the arm, m.
    """
    fewest = min((target.throws for part in parts for target in part.targets), default=0)
    return render_page(
        Path(__file__).parent,
        "accuracy.html.j2",
        modes=[_mode(part, reach_m) for part in parts],
        fewest=fewest,
        needed=MIN_THROW_COUNT,
        scatter_range_m=SCATTER_RANGE_M,
        max_spread_ratio=MAX_SPREAD_RATIO,
        file_name=_file_name,
        signed_height=_signed_height,
    )


def _mode(part: ModeEvaluation, reach_m: float) -> dict[str, Any]:
    """What the template shows of one mode."""
    mode = part.mode
    return {
        "name": mode.upper(),
        "part": part,
        "landed": sum(t.landed for t in part.targets),
        "thrown": sum(t.throws for t in part.targets),
        "landed_interval": _landed_interval(part.targets),
        "checks": check_requirements(part) if part.targets else [],
        "rows": [(t, requirement_at(mode, t.range_m), unmet_fields(mode, t)) for t in part.targets],
        "simulated": SIMULATED[mode],
        "range_drawings": _range_drawings(part, reach_m),
        "paper": SCATTER[mode],
        "scatter": _scatter(part),
        "causes": error_budget(part),
        "sensitivity_drawing": sensitivity_plot(
            part.sensitivity, f"shift of the mean error by factor, {mode}"
        )
        if part.sensitivity
        else None,
        "pace_drawings": [
            pace_plot(part.paces, f"{mode} spread over {words}", by_speed=by_speed)
            for words, by_speed in (("time", False), ("release speed", True))
        ],
        "ratios": spread_ratios(part.units),
        "ablation": part.wide_unit,
        "ablation_conclusion": ablation_conclusion(part.wide_unit) if part.wide_unit else "",
        "trainings": sorted(part.trainings, key=lambda training: training.row.range_m),
    }


def _range_drawings(part: ModeEvaluation, reach_m: float) -> Markup:
    if not part.targets:
        return Markup("")
    mode = part.mode
    return range_plot(
        part.targets, reach_m, f"{mode} mean impact and 1 sigma by target range"
    ) + spread_plot(part.targets, REQUIREMENTS[mode], f"{mode} spread by target range")


def _scatter(part: ModeEvaluation) -> dict[str, Any] | None:
    """Landings at the paper's target, and its figures beside ours; None without this target."""
    target, paper = part.scatter, SCATTER[part.mode]
    if target is None:
        return None
    words = f"{part.mode} landings about the target at {SCATTER_RANGE_M:g} m"
    return {
        "landed": target.landed,
        "drawing": landing_plot(target, paper, words),
        "rows": (
            ("mean downrange error", target.mean_downrange_error_m,
             paper.mean_range_m - SCATTER_RANGE_M),
            ("sd downrange", target.sd_downrange_m, paper.sd_downrange_m),
            ("mean crossrange error", target.mean_crossrange_error_m, paper.mean_crossrange_m),
            ("sd crossrange", target.sd_crossrange_m, paper.sd_crossrange_m),
        ),
    }  # fmt: skip


def _landed_interval(targets: Sequence[TargetRow]) -> Interval | None:
    landed, thrown = sum(t.landed for t in targets), sum(t.throws for t in targets)
    return proportion_interval(landed, thrown, CONFIDENCE_RATIO) if thrown else None


def _file_name(path: str) -> str:
    return Path(path).name


def _signed_height(value_m: float) -> str:
    """Height of a target above the ground with its sign."""
    return "0 m" if value_m == 0.0 else f"{value_m:+g} m".replace("-", MINUS)
