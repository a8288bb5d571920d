"""An evaluation as one HTML page that needs nothing else: no script, no network, light and dark."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from diagnosis.evaluation.conditions import ConditionRow
from diagnosis.evaluation.drawings import (
    front_plot,
    landing_plot,
    range_plot,
    sensitivity_plot,
)
from diagnosis.evaluation.measures import Estimate, ModeEvaluation, TargetRow
from diagnosis.evaluation.paper import SCATTER, SCATTER_RANGE_M, SIMULATED
from diagnosis.evaluation.sensitivity import FactorShift
from diagnosis.report.report_html import page, section
from diagnosis.report.report_words import NONE, fixed, percent

_STYLE = Path(__file__).with_name("evaluation.css")


def evaluation_html(parts: Sequence[ModeEvaluation], reach_m: float) -> str:
    """The page.

    Args:
        parts: one or both modes.
        reach_m: static reach of the arm.
    """
    body = "".join(
        (
            _head(parts),
            _ranges(parts, reach_m),
            _scatters(parts),
            *(_targets(part) for part in parts),
            *(_conditions(part) for part in parts),
            *(_sensitivity(part) for part in parts),
            *(_failures(part) for part in parts),
        )
    )
    return page("Accuracy of throws", body, _STYLE.read_text(encoding="utf-8"))


def _head(parts: Sequence[ModeEvaluation]) -> str:
    rows = "".join(
        f"<tr><td>{part.mode.upper()}</td><td>{escape(part.policy)}</td>"
        f"<td>{escape(part.plant)}, unit {part.unit_seed}, seed {part.seed}</td>"
        f'<td class="number">{sum(t.throws for t in part.targets)}</td>'
        f'<td class="number">{_wilson(part)}</td>'
        f'<td class="number">{_cell(part.start_to_release_s, "s")}</td>'
        f'<td class="number">{_cell(part.start_to_landing_s, "s")}</td>'
        f'<td class="number">{part.seconds:.1f} s, {part.real_time_factor:.0f} x real time</td></tr>'
        for part in parts
    )
    return "<h1>Accuracy of throws</h1>" + section(
        "What was thrown",
        '<div class="scroll"><table><tr><th>mode</th><th>policy</th><th>on</th><th>throws</th>'
        "<th>landed</th><th>start to release</th><th>start to surveyed landing</th>"
        f"<th>computing</th></tr>{rows}</table></div>"
        '<p class="dim">Every throw from a random start pose. All intervals in this page are 95 %: of means '
        "by Student's t, of standard deviations by chi-square, of shares by Wilson's score.</p>",
    )


def _wilson(part: ModeEvaluation) -> str:
    landed, thrown = sum(t.landed for t in part.targets), sum(t.throws for t in part.targets)
    return f"{landed} of {thrown}"


def _ranges(parts: Sequence[ModeEvaluation], reach_m: float) -> str:
    drawn = "".join(
        f"<figure><figcaption>{part.mode.upper()} policy. Paper, simulated: "
        f"{escape(SIMULATED[part.mode])}.</figcaption>"
        f"{range_plot(part.targets, reach_m, f'{part.mode} mean impact and 1 sigma by target range')}"
        "</figure>"
        for part in parts
    )
    return section(
        "Range",
        '<p class="dim">Mean impact over the target; upright bar: one standard deviation downrange, level '
        f'bar: crossrange.</p><div class="pair">{drawn}</div>',
    )


def _scatters(parts: Sequence[ModeEvaluation]) -> str:
    drawn: list[str] = []
    for part in parts:
        target = part.scatter
        if target is None:
            continue
        paper = SCATTER[part.mode]
        words = f"{part.mode} landings about the target at {SCATTER_RANGE_M:g} m"
        rows = "".join(
            f'<tr><td>{name}</td><td class="number">{_cell(ours, "m")}</td>'
            f'<td class="number">{fixed(theirs)} m</td></tr>'
            for name, ours, theirs in (
                ("mean downrange error", target.mean_downrange_error_m,
                 paper.mean_range_m - SCATTER_RANGE_M),
                ("sd downrange", target.sd_downrange_m, paper.sd_downrange_m),
                ("mean crossrange error", target.mean_crossrange_error_m, paper.mean_crossrange_m),
                ("sd crossrange", target.sd_crossrange_m, paper.sd_crossrange_m),
            )
        )  # fmt: skip
        drawn.append(
            f"<figure><figcaption>{part.mode.upper()}, {target.landed} landings</figcaption>"
            f"{landing_plot(target, paper, words)}"
            f"<table><tr><th></th><th>here</th><th>paper, {paper.throw_count} real throws</th></tr>"
            f"{rows}</table></figure>"
        )
    if not drawn:
        return section(
            f"Landings at {SCATTER_RANGE_M:g} m",
            f"<p>No target at {SCATTER_RANGE_M:g} m was thrown at; name it in --targets.</p>",
        )
    return section(
        f"Landings at {SCATTER_RANGE_M:g} m",
        '<p class="dim">Ellipses of one standard deviation; dashed: the paper\'s real machine, axes taken '
        f'parallel.</p><div class="pair">{"".join(drawn)}</div>',
    )


def _targets(part: ModeEvaluation) -> str:
    rows = "".join(_row(target) for target in part.targets)
    return section(
        f"By target, {part.mode.upper()}",
        '<div class="scroll"><table><tr><th>range</th><th>landed</th><th>mean downrange error</th>'
        "<th>sd downrange</th><th>mean crossrange error</th><th>sd crossrange</th></tr>"
        f"{rows}</table></div>",
    )


def _row(target: TargetRow) -> str:
    share = target.success_ratio
    low, high = share.ci95 or (float("nan"), float("nan"))
    cells = "".join(
        f'<td class="number">{_cell(value, "m")}</td>'
        for value in (
            target.mean_downrange_error_m,
            target.sd_downrange_m,
            target.mean_crossrange_error_m,
            target.sd_crossrange_m,
        )
    )
    return (
        f'<tr><td class="number">{target.range_m:g} m</td><td class="number">{target.landed} of '
        f'{target.throws}<br><span class="dim">{percent(low)} to {percent(high)}</span></td>{cells}</tr>'
    )


def _conditions(part: ModeEvaluation) -> str:
    """The front from careful to fast, and targets off the ground."""
    mode = part.mode.upper()
    paces = (
        f"<figure>{front_plot(part.paces, f'{part.mode} spread over time and release speed')}</figure>"
        f"{_condition_table(part.paces)}"
        if part.paces
        else "<p>This policy was trained without a pace: it throws in one way.</p>"
    )
    heights = (
        _condition_table(part.heights)
        if part.heights
        else "<p>This policy was trained for targets on the ground alone.</p>"
    )
    return section(f"Careful to fast, {mode}", paces) + section(f"Off the ground, {mode}", heights)


def _condition_table(rows: Sequence[ConditionRow]) -> str:
    cells = "".join(
        f'<tr><td class="number">{row.range_m:g} m</td><td class="number">{row.height_m:+g} m</td>'
        f'<td class="number">{row.pace_ratio:g}</td>'
        f'<td class="number">{row.landed_count} of {row.throw_count}</td>'
        + "".join(
            f'<td class="number">{NONE if v is None else f"{fixed(v, digits)} {unit}"}</td>'
            for v, digits, unit in (
                (row.mean_downrange_error_m, 3, "m"),
                (row.sd_downrange_m, 3, "m"),
                (row.mean_crossrange_error_m, 3, "m"),
                (row.sd_crossrange_m, 3, "m"),
                (row.start_to_release_s, 2, "s"),
                (row.release_speed_m_per_s, 2, "m/s"),
            )
        )
        + "</tr>"
        for row in rows
    )
    return (
        '<div class="scroll"><table><tr><th>range</th><th>height</th><th>pace</th><th>landed</th>'
        "<th>mean downrange error</th><th>sd downrange</th><th>mean crossrange error</th>"
        f"<th>sd crossrange</th><th>start to release</th><th>release speed</th></tr>{cells}</table></div>"
    )


def _sensitivity(part: ModeEvaluation) -> str:
    title = f"What a miss hangs on, {part.mode.upper()}"
    if not part.sensitivity:
        return section(title, f"<p>{escape(part.sensitivity_note)}</p>")
    rows = "".join(_factor(shift) for shift in part.sensitivity)
    return section(
        title,
        f'<p class="dim">{escape(part.sensitivity_note)} Target at {part.sensitivity_range_m:g} m; the same '
        "throws with one thing changed at a time, compared throw by throw. Dashed low, solid high.</p>"
        f"<figure>{sensitivity_plot(part.sensitivity, title)}</figure>"
        '<div class="scroll"><table><tr><th>factor</th><th>low</th><th>high</th><th>high, crossrange</th>'
        f"<th>sd, high over as it is</th><th>pairs</th></tr>{rows}</table></div>",
    )


def _factor(shift: FactorShift) -> str:
    cells = "".join(
        f'<td class="number">{_cell(Estimate(value=value, ci95=ends), "m")}</td>'
        for value, ends in (
            (shift.low_m, shift.low_ci95_m),
            (shift.high_m, shift.high_ci95_m),
            (shift.crossrange_high_m, shift.crossrange_high_ci95_m),
        )
    )
    lost = f", {shift.failed_count} failed" if shift.failed_count else ""
    return (
        f"<tr><td class='name'>{escape(shift.name)}<br>"
        f"<span class='dim'>{escape(shift.change)}</span></td>{cells}"
        f'<td class="number">{fixed(shift.sd_ratio)}</td>'
        f'<td class="number">{shift.pair_count}{lost}</td></tr>'
    )


def _failures(part: ModeEvaluation) -> str:
    title = f"Throws that ended badly, {part.mode.upper()}"
    if not part.failures:
        return section(title, "<p>None.</p>")
    rows = "".join(
        f'<tr><td class="number">{failure.number}</td><td class="number">{failure.range_m:g} m</td>'
        f"<td>{escape(failure.outcome)}{', after the release' if failure.after_release else ''}</td><td>"
        + (
            f'<a href="{escape(failure.log)}">{escape(Path(failure.log).name)}</a>'
            if failure.log
            else NONE
        )
        + "</td></tr>"
        for failure in part.failures
    )
    return section(
        title,
        "<table><tr><th>throw</th><th>target</th><th>how it ended</th><th>log, to be replayed</th></tr>"
        f"{rows}</table>",
    )


def _cell(estimate: Estimate, unit: str) -> str:
    """A value over its interval."""
    if estimate.value is None:
        return NONE
    digits = 2 if unit == "s" else 3
    text = f"{fixed(estimate.value, digits)} {unit}"
    if estimate.ci95 is None:
        return text
    low, high = (fixed(v, digits) for v in estimate.ci95)
    return f'{text}<br><span class="dim">{low} to {high}</span>'
