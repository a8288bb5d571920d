"""A commissioning as one HTML page."""

from pathlib import Path

from markupsafe import Markup

from diagnosis.identification.commissioning_record import (
    PHASE_WORDS,
    STEPS,
    Commissioning,
    JointFit,
)
from diagnosis.loading.kept_reference import advice, words_of_days
from reports.html import render_page
from reports.svg import Axes, Margins, drawing, round_ticks

WIDTH, HEIGHT = 480.0, 190.0
MARGINS = Margins(left=46.0, right=8.0, top=8.0, bottom=22.0)


def commissioning_html(found: Commissioning) -> str:
    """The page."""
    days = found.reference_day_count
    return render_page(
        Path(__file__).parent,
        "commissioning.html.j2",
        found=found,
        steps=[(words, found.steps.get(name)) for name, words in STEPS.items()],
        phases=PHASE_WORDS,
        joints=[(fit, speed_drawing(fit)) for fit in found.joints],
        quantities=found.quantities(),
        flags=found.flags(),
        reference=words_of_days(days),
        advice=advice(days),
    )


def speed_drawing(fit: JointFit) -> Markup:
    """Measured and simulated speed of the run that is explained worst."""
    t, measured, simulated = (fit.plot[name] for name in ("t_s", "measured", "simulated"))
    low, high = min(*measured, *simulated, -0.01), max(*measured, *simulated, 0.01)
    axes = Axes((t[0], t[-1]), (low, high), WIDTH, HEIGHT, MARGINS)
    parts = [axes.x_tick(value) for value in round_ticks(t[0], t[-1], 6)]
    parts += [axes.y_tick(value) for value in round_ticks(low, high, 4)]
    parts += [
        axes.path(css, zip(t, y, strict=True))
        for css, y in (("measured", measured), ("after", simulated))
    ]
    return drawing(WIDTH, HEIGHT, f"{fit.joint}: measured and simulated speed", parts)
