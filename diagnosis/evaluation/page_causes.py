"""The evaluation page on what holds accuracy back: parts of the spread, factors, units, trainings."""

from collections.abc import Sequence
from html import escape
from typing import Literal, NamedTuple

import numpy as np

from diagnosis.evaluation.drawings import sensitivity_plot
from diagnosis.evaluation.goals import UNSEEN_RATIO
from diagnosis.evaluation.measures import Estimate, ModeEvaluation, UnitRow
from diagnosis.evaluation.page_cells import cell, table
from diagnosis.evaluation.sensitivity import FactorShift
from diagnosis.evaluation.wide_unit import WideUnit
from diagnosis.intervals import Interval
from diagnosis.report.evidence_html import section
from diagnosis.report.report_words import NONE, fixed


class Cause(NamedTuple):
    """One thing that costs accuracy at the target of the sensitivities."""

    words: str
    metres: float
    kind: str
    """How it shows: in the mean or in the spread."""


def causes(part: ModeEvaluation) -> list[Cause]:
    """What costs accuracy, the largest first; downrange, m."""
    found: list[Cause] = []
    spread = part.spread
    if spread is not None:
        found += [
            Cause("start pose", spread.between_starts_downrange_m, "spread between starts"),
            Cause(
                "chance: release, valves, sensors",
                spread.within_start_downrange_m,
                "spread of throws from one start",
            ),
        ]
    at = next((t for t in part.targets if t.range_m == part.sensitivity_range_m), None)
    mean = None if at is None else at.mean_downrange_error_m.value
    if mean is not None:
        found.append(Cause("what the policy or the registration leaves", abs(mean), "mean"))
    for shift in part.sensitivity:
        sides = [abs(v) for v in (shift.low_m, shift.high_m) if v is not None]
        if sides:
            words = f"{shift.name}, off by {shift.change.removeprefix('-/+ ')}"
            found.append(Cause(words, float(np.mean(sides)), "mean, if it is off by that"))
    others = [u.mean_downrange_error_m for u in part.units[1:]]
    known = [m for m in others if m is not None]
    if known:
        rms = float(np.sqrt(np.mean(np.square(known))))
        found.append(Cause("another machine of the type, registered", rms, "mean of its targets"))
    return sorted(found, key=lambda cause: -cause.metres)


def held_back(part: ModeEvaluation) -> str:
    """The largest causes at one target, in metres."""
    title = f"What holds it back, {part.mode.upper()}"
    found = causes(part)
    if not found or part.sensitivity_range_m is None:
        return section(title, f"<p>{escape(part.sensitivity_note)}</p>")
    first = found[0]
    body = table(
        ("cause", "downrange", "shows in"),
        [
            (("name", escape(c.words)), ("number", f"{fixed(c.metres, 3)} m"), ("", escape(c.kind)))
            for c in found
        ],
    )
    parts = ""
    if part.spread is not None:
        s = part.spread
        parts = (
            f" {s.throw_count} throws from {s.start_count} starts: "
            f"{fixed(s.between_starts_downrange_m, 3)} m between starts and "
            f"{fixed(s.within_start_downrange_m, 3)} m between throws from one start downrange, "
            f"{fixed(s.between_starts_crossrange_m, 3)} m and "
            f"{fixed(s.within_start_crossrange_m, 3)} m crossrange."
        )
    return section(
        title,
        f"<p>At {part.sensitivity_range_m:g} m most is lost by <b>{escape(first.words)}</b> "
        f"({fixed(first.metres, 3)} m).{escape(parts)}</p>{body}",
    )


def sensitivity_section(part: ModeEvaluation) -> str:
    """The same throws with one thing changed at a time."""
    title = f"What a miss hangs on, {part.mode.upper()}"
    if not part.sensitivity:
        return section(title, f"<p>{escape(part.sensitivity_note)}</p>")
    rows = [_factor(shift) for shift in part.sensitivity]
    return section(
        title,
        f'<p class="dim">{escape(part.sensitivity_note)} Target at {part.sensitivity_range_m:g} m; the same '
        "throws with one thing changed at a time, compared throw by throw. Dashed low, solid high.</p>"
        f"<figure>{sensitivity_plot(part.sensitivity, title)}</figure>"
        + table(
            (
                "factor", "mean shift, low", "mean shift, high", "crossrange, high",
                "sd: low, as it is, high", "pairs",
            ),
            rows,
        ),
    )  # fmt: skip


def _factor(shift: FactorShift) -> list[tuple[str, str]]:
    lost = f", {shift.failed_count} failed" if shift.failed_count else ""
    deviations = (shift.low_sd_m, shift.plain_sd_m, shift.high_sd_m)
    return [
        ("name", f"{escape(shift.name)}<br><span class='dim'>{escape(shift.change)}</span>"),
        *(
            ("number", cell(Estimate(value=value, ci95=ends), "m"))
            for value, ends in (
                (shift.low_m, shift.low_ci95_m),
                (shift.high_m, shift.high_ci95_m),
                (shift.crossrange_high_m, shift.crossrange_high_ci95_m),
            )
        ),
        ("number", ", ".join(NONE if v is None else fixed(v, 3) for v in deviations) + " m"),
        ("number", f"{shift.pair_count}{lost}"),
    ]


def units_section(part: ModeEvaluation) -> str:
    """Machines that no training has seen."""
    title = f"Machines never seen, {part.mode.upper()}"
    if not part.units:
        return section(title, "<p>None were thrown with; --units 20 does.</p>")
    rows = [
        (
            ("number", str(u.unit_seed)),
            ("number", f"{u.landed_count} of {u.throw_count}"),
            *_numbers(
                u.mean_downrange_error_m, u.sd_downrange_m, u.mean_crossrange_error_m,
                u.sd_crossrange_m,
            ),
        )
        for u in part.units
    ]  # fmt: skip
    words = "".join(_factors(part.units, way) for way in ("downrange", "crossrange"))
    return section(
        title,
        '<p class="dim">Each measured and registered as at its first start; root mean squares over its '
        f"targets.</p>{words}"
        + table(("unit", "landed", *_NUMBERS), rows),
    )  # fmt: skip


def _factors(units: Sequence[UnitRow], way: Literal["downrange", "crossrange"]) -> str:
    """How much wider than the first machine the others throw, and which of them too much."""

    def spread(unit: UnitRow) -> float | None:
        return unit.sd_downrange_m if way == "downrange" else unit.sd_crossrange_m

    nominal = spread(units[0])
    known = [(s / nominal, u.unit_seed) for u in units[1:] if nominal and (s := spread(u))]
    if not known:
        return ""
    wide = [str(seed) for factor, seed in known if factor > UNSEEN_RATIO]
    beyond = f"beyond it: {', '.join(wide)}" if wide else "kept by all"
    return (
        f"<p>Spread {way} over unit {units[0].unit_seed}'s: median "
        f"{fixed(float(np.median([factor for factor, _ in known])))}, worst {fixed(max(known)[0])}; "
        f"asked: {fixed(UNSEEN_RATIO)}, {beyond}.</p>"
    )


def wide_section(part: ModeEvaluation) -> str:
    """One property of the widest machine at a time as drawn."""
    wide = part.wide_unit
    if wide is None:
        return ""
    where = f"{wide.way} at {wide.range_m:g} m"
    words = (
        f"Unit {wide.unit_seed}, {where}, comes nearest to the factor asked for, or exceeds it most: "
        f"{fixed(wide.chosen_sd_m, 3)} m beside {fixed(wide.chosen_nominal_sd_m, 3)} m of unit 0. In "
        f"{wide.pair_count} throws from other starts it has <b>{fixed(wide.sd_m, 3)} m</b> as built and "
        f"<b>{fixed(wide.drawn_sd_m, 3)} m</b> with everything as drawn. {_together(wide)}"
    )
    rows = [
        (
            ("name", escape(row.name)),
            ("number", f"{fixed(row.sd_m, 3)} m"),
            ("number", _share(row.share_ratio, row.share_ci95_ratio)),
            ("number", str(row.failed_count)),
        )
        for row in wide.properties
    ]
    added = (
        ("name", "added up"),
        ("number", NONE),
        ("number", _share(wide.single_sum_ratio, wide.single_sum_ci95_ratio)),
        ("number", ""),
    )
    heads = ("as drawn", f"sd {wide.way}", "takes away of what is added", "failed")
    rows = [*rows, added]
    if wide.single_sum_ratio is None:
        # Nothing is added: there is no share of it.
        heads, rows = (*heads[:2], heads[3]), [(*row[:2], row[3]) for row in rows[:-1]]
    return section(
        f"What makes a machine wide, {part.mode.upper()}",
        f'<p>{words}</p><p class="dim">The same throws with one property at a time as drawn, the machine '
        "measured and registered anew each time. Shares are of the variance that it has beyond the drawing's "
        "machine, with 95 % intervals by resampling throws.</p>" + table(heads, rows),
    )


def _share(ratio: float | None, ends: Interval | None) -> str:
    if ratio is None or ends is None:
        return NONE
    low, high = (fixed(100.0 * end, 0) for end in ends)
    return f'{fixed(100.0 * ratio, 0)} %<br><span class="dim">{low} to {high} %</span>'


def _together(wide: WideUnit) -> str:
    """What the single properties say of the whole."""
    ends = wide.single_sum_ci95_ratio
    if ends is None:
        return "That is not wider beyond chance: what made it the widest was luck, not how it is built."
    known = [
        f"{escape(row.name)} ({fixed(100.0 * (row.share_ratio or 0.0), 0)} %)"
        for row in wide.properties
        if row.share_ci95_ratio is not None and row.share_ci95_ratio[0] > 0.0
    ]
    single = (
        f"Each alone as drawn takes away: {', '.join(known)}."
        if known
        else "No property stands out."
    )
    if ends[0] > 1.0:
        return f"{single} Added up that is more than all: several must meet, a rare combination."
    if ends[1] < 1.0:
        return f"{single} Added up that is less than all: one of several is enough to make it wide."
    return f"{single} Whether several must meet does not show in these throws."


def trainings_section(part: ModeEvaluation) -> str:
    """All trainings of the mode side by side: how much is luck."""
    if not part.trainings:
        return ""
    rows = [
        (
            ("policy", escape(t.policy)),
            ("number", str(t.training_seed)),
            ("number", f"{t.step_count / 1e9:.2f}e9"),
            ("", "yes" if t.is_registered else "no"),
            ("number", f"{t.row.range_m:g} m"),
            ("number", f"{t.row.landed_count} of {t.row.throw_count}"),
            *_numbers(
                t.row.mean_downrange_error_m, t.row.sd_downrange_m,
                t.row.mean_crossrange_error_m, t.row.sd_crossrange_m,
            ),
        )
        for t in sorted(part.trainings, key=lambda t: t.row.range_m)
    ]  # fmt: skip
    return section(
        f"Trainings side by side, {part.mode.upper()}",
        '<p class="dim">The same starts and the same machine for all, registered with each by itself.</p>'
        + table(
            ("training", "seed", "control steps", "registered", "range", "landed", *_NUMBERS), rows
        ),
    )


_NUMBERS = ("mean downrange error", "sd downrange", "mean crossrange error", "sd crossrange")


def _numbers(*values: float | None) -> Sequence[tuple[str, str]]:
    return [("number", NONE if v is None else f"{fixed(v, 3)} m") for v in values]
