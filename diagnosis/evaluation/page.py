"""An evaluation as one HTML page that needs nothing else: no script, no network, light and dark."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from diagnosis.evaluation.conditions import ConditionRow
from diagnosis.evaluation.drawings import front_plot, landing_plot, range_plot, spread_plot
from diagnosis.evaluation.goals import GOALS, Goal, goal_at, shortfalls
from diagnosis.evaluation.measures import CONFIDENCE_RATIO, ModeEvaluation, TargetRow
from diagnosis.evaluation.page_asked import asked_section
from diagnosis.evaluation.page_causes import (
    held_back,
    sensitivity_section,
    trainings_section,
    units_section,
    wide_section,
)
from diagnosis.evaluation.page_cells import cell, height, share, table
from diagnosis.evaluation.paper import SCATTER, SCATTER_RANGE_M, SIMULATED
from diagnosis.intervals import share_interval
from diagnosis.report.evidence_html import section
from diagnosis.report.report_html import page
from diagnosis.report.report_words import NONE, fixed

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
            asked_section(parts),
            _ranges(parts, reach_m),
            _scatters(parts),
            *(_targets(part) for part in parts),
            *(held_back(part) for part in parts),
            *(sensitivity_section(part) for part in parts),
            *(_conditions(part) for part in parts),
            *(units_section(part) for part in parts),
            *(wide_section(part) for part in parts),
            *(trainings_section(part) for part in parts),
            *(_failures(part) for part in parts),
        )
    )
    return page("Accuracy of throws", body, _STYLE.read_text(encoding="utf-8"))


def _head(parts: Sequence[ModeEvaluation]) -> str:
    rows = [
        (
            ("", part.mode.upper()),
            ("policy", escape(part.policy)),
            ("", escape(_where(part))),
            ("number", str(sum(t.throws for t in part.targets))),
            ("number", _wilson(part)),
            ("number", cell(part.start_to_release_s, "s")),
            ("number", cell(part.start_to_landing_s, "s")),
            ("number", f"{part.seconds:.1f} s,<br>{part.real_time_factor:.0f} x real time"),
        )
        for part in parts
    ]
    heads = (
        "mode", "policy", "on", "throws", "landed", "start to release",
        "cycle: start to surveyed landing", "computing",
    )  # fmt: skip
    return "<h1>Accuracy of throws</h1>" + section(
        "What was thrown",
        table(heads, rows)
        + "".join(f"<p>{part.mode.upper()}: {escape(_provenance(part))}</p>" for part in parts)
        + '<p class="dim">Every throw from a random start pose. All intervals in this page are 95 %: of '
        "means by Student's t, of standard deviations by chi-square, of shares by Wilson's score.</p>",
    )


def _where(part: ModeEvaluation) -> str:
    words = f"{part.plant}, unit {part.unit_seed}"
    return words if part.is_registered else f"{words}, not registered"


def _provenance(part: ModeEvaluation) -> str:
    """How the machine aims, which file threw, and whether the throws can have been known before it."""
    seed = (
        f"Seed {part.seed} was drawn when this evaluation began, the policy being fixed."
        if part.seed_is_drawn
        else f"Seed {part.seed} was given: whether the policy was fixed before it, only its giver knows."
    )
    file = f"policy.onnx has sha256 {part.policy_sha256[:12]}." if part.policy_sha256 else ""
    return f"{part.aim}. {seed} {file}".strip(". ") + "."


def _wilson(part: ModeEvaluation) -> str:
    landed, thrown = sum(t.landed for t in part.targets), sum(t.throws for t in part.targets)
    low, high = share_interval(landed, thrown, CONFIDENCE_RATIO)
    return f'{landed} of {thrown}<br><span class="dim">{share(low)} to {share(high)}</span>'


def _ranges(parts: Sequence[ModeEvaluation], reach_m: float) -> str:
    drawn = "".join(
        f"<figure><figcaption>{part.mode.upper()} policy. Paper, simulated: "
        f"{escape(SIMULATED[part.mode])}.</figcaption>"
        f"{range_plot(part.targets, reach_m, f'{part.mode} mean impact and 1 sigma by target range')}"
        f"{spread_plot(part.targets, GOALS[part.mode], f'{part.mode} spread by target range')}"
        "</figure>"
        for part in parts
    )
    return section(
        "Range",
        '<p class="dim">Above: mean impact over the target; upright bar: one standard deviation downrange, '
        "level bar: crossrange. Below: standard deviations with 95 % intervals, downrange filled, crossrange "
        "hollow and a little to the right; steps: the most that is asked.</p>"
        f'<div class="pair">{drawn}</div>',
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
            f'<tr><td>{name}</td><td class="number">{cell(ours, "m")}</td>'
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
    rows = [_row(part.mode, target) for target in part.targets]
    missed = sum(1 for target in part.targets if shortfalls(part.mode, target))
    words = (
        "Every figure is as small as asked."
        if missed == 0
        else f"At {missed} of {len(part.targets)} targets a figure is larger than asked (marked); what holds "
        "it back is told below."
    )
    return section(
        f"By target, {part.mode.upper()}",
        f"<p>{words}</p>"
        + table(
            (
                "range", "landed", "mean downrange error", "sd downrange", "mean crossrange error",
                "sd crossrange", "asked: mean, sd at most",
            ),
            rows,
        ),
    )  # fmt: skip


def _row(mode: str, target: TargetRow) -> list[tuple[str, str]]:
    low, high = target.success_ratio.ci95 or (float("nan"), float("nan"))
    goal, large = goal_at(mode, target.range_m), shortfalls(mode, target)
    names = (
        "mean_downrange_error_m",
        "sd_downrange_m",
        "mean_crossrange_error_m",
        "sd_crossrange_m",
    )
    return [
        ("number", f"{target.range_m:g} m"),
        (
            "number",
            f"{target.landed} of {target.throws}<br>"
            f'<span class="dim">{share(low)} to {share(high)}</span>',
        ),
        *(
            ("number large" if name in large else "number", cell(getattr(target, name), "m"))
            for name in names
        ),
        ("number", _asked(goal)),
    ]


def _asked(goal: Goal | None) -> str:
    if goal is None:
        return NONE
    return f"{NONE if goal.bias_m is None else fixed(goal.bias_m)}, {fixed(goal.sd_m)} m"


def _conditions(part: ModeEvaluation) -> str:
    """The front from careful to fast, and targets off the ground."""
    mode = part.mode.upper()
    paces = (
        '<p class="dim">One line a range, from careful (pace 0, amber) to fast (pace 1).</p>'
        '<div class="pair">'
        f"<figure>{front_plot(part.paces, f'{part.mode} spread over time', by_speed=False)}</figure>"
        f"<figure>{front_plot(part.paces, f'{part.mode} spread over release speed', by_speed=True)}</figure>"
        f"</div>{_condition_table(part.paces)}"
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
    body = [
        [
            ("number", words)
            for words in (
                f"{row.range_m:g} m",
                height(row.height_m),
                f"{row.pace_ratio:g}",
                f"{row.landed_count} of {row.throw_count}",
                *(
                    NONE if v is None else f"{fixed(v, digits)} {unit}"
                    for v, digits, unit in (
                        (row.mean_downrange_error_m, 3, "m"),
                        (row.sd_downrange_m, 3, "m"),
                        (row.mean_crossrange_error_m, 3, "m"),
                        (row.sd_crossrange_m, 3, "m"),
                        (row.start_to_release_s, 2, "s"),
                        (row.release_speed_m_per_s, 2, "m/s"),
                    )
                ),
            )
        ]
        for row in rows
    ]
    heads = (
        "range", "height", "pace", "landed", "mean downrange error", "sd downrange",
        "mean crossrange error", "sd crossrange", "start to release", "release speed",
    )  # fmt: skip
    return table(heads, body)


def _failures(part: ModeEvaluation) -> str:
    title = f"Throws that ended badly, {part.mode.upper()}"
    only = (
        '<p class="dim">Of the throws by target; those of the other tables are counted there.</p>'
    )
    if not part.failures:
        return section(title, f"<p>None.</p>{only}")
    rows = "".join(
        f'<tr><td class="number">{failure.number}</td><td class="number">{failure.range_m:g} m</td>'
        f"<td>{escape(failure.outcome.replace('_', ' '))}"
        f"{', after the opening command' if failure.after_release else ''}</td><td>"
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
        f"{only}<table><tr><th>throw</th>"
        "<th>target</th><th>how it ended</th><th>log, to be replayed</th></tr>"
        f"{rows}</table>",
    )
