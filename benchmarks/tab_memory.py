"""Memory of a console's tab that is left open on page Operate with live data.

    python -m benchmarks.tab_memory 10 [--json FILE]

A demo of its own, a real Chromium, an operator in control. Measured every minute after a forced collection
of garbage: the heap of the page's JavaScript, its 3D view included, and the nodes of its documents.
Extrapolated: the line through the samples from `SETTLED_MIN` on, over a shift of 8 hours.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from playwright.sync_api import CDPSession, Page, sync_playwright

from benchmarks.result_file import RESULTS, Row, Value, describe, row, write_result
from tests.chromium import CHROMIUM, FLAGS
from tests.e2e.operator_page import sign_in, take_control
from tests.e2e.stack import running_demo

SETTLED_MIN = 2
"""Before that, code is compiled and caches fill."""
SHIFT_H = 8.0
LIMIT_MB = 50.0


@dataclass(frozen=True)
class Sample:
    """What a tab holds at one moment."""

    minute: float
    heap_mb: float
    """Used by JavaScript, 1e6 bytes."""
    node_count: float


def take_sample(session: CDPSession, began_s: float) -> Sample:
    """Collect the garbage and read what is left; twice, for finalisers give more to collect."""
    for _ in range(2):
        session.send("HeapProfiler.collectGarbage")
    used = session.send("Runtime.getHeapUsage")["usedSize"]
    counted = session.send("Memory.getDOMCounters")["nodes"]
    return Sample((time.monotonic() - began_s) / 60.0, used * 1e-6, float(counted))


def watch(page: Page, minutes: int) -> list[Sample]:
    """A sample now and after every minute."""
    session = page.context.new_cdp_session(page)
    began_s = time.monotonic()
    samples = [take_sample(session, began_s)]
    for minute in range(1, minutes + 1):
        page.wait_for_timeout(1e3 * max(60.0 * minute - (time.monotonic() - began_s), 0.0))
        samples.append(take_sample(session, began_s))
        print(samples[-1])
    return samples


def growth_mb(samples: list[Sample]) -> Value:
    """Growth over a shift with its 95 % interval: least squares, normal approximation."""
    settled = [sample for sample in samples if sample.minute >= SETTLED_MIN - 0.1]
    if len(settled) < 3:
        return Value(value=None)
    minute = np.array([sample.minute for sample in settled])
    heap = np.array([sample.heap_mb for sample in settled])
    centred = minute - minute.mean()
    slope = float(centred @ heap / (centred @ centred))
    left = heap - heap.mean() - slope * centred
    error = float(np.sqrt(left @ left / (len(settled) - 2) / (centred @ centred)))
    scale = 60.0 * SHIFT_H
    return Value(
        value=scale * slope, low=scale * (slope - 1.96 * error), high=scale * (slope + 1.96 * error)
    )


def rows_of(samples: list[Sample]) -> list[Row]:
    """One row a minute, then the extrapolation."""
    minutes = [
        row(
            1,
            {"after": f"{sample.minute:.0f} min"},
            {"heap_mb": sample.heap_mb, "node_count": sample.node_count},
        )
        for sample in samples
    ]
    growth = growth_mb(samples)
    shift = {"heap_growth_mb": growth}
    return [*minutes, row(len(samples), {"after": f"{SHIFT_H:.0f} h, extrapolated"}, shift)]


def main(minutes: tyro.conf.Positional[int] = 10, json: Path = RESULTS / "tab_memory.json") -> None:
    """Leave a tab open for `minutes`."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running_demo(Path(folder)) as stack,
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS) as browser,
    ):
        context = browser.new_context(
            base_url=stack.url,
            viewport={"width": 1024, "height": 768},
            device_scale_factor=0.25,  # The picture is drawn without graphics hardware.
        )
        context.set_default_timeout(120e3)
        page = context.new_page()
        sign_in(page, stack)
        take_control(page)
        page.locator('[data-testid="viewer"][data-state="drawn"]').wait_for()
        print(f"a tab of {stack.url} is watched for {minutes} min")
        samples = watch(page, minutes)
    notes = (
        f"Limit: {LIMIT_MB:.0f} MB in {SHIFT_H:.0f} h. {minutes} min measured; the growth is the line "
        f"through the heap from minute {SETTLED_MIN} on."
    )
    rows = rows_of(samples)
    print(rows[-1].values["heap_growth_mb"], notes)
    title = "Memory of a tab left open on page Operate"
    write_result(describe("tab_memory", title, rows, seed=None, notes=notes), json)


if __name__ == "__main__":
    tyro.cli(main)
