"""Progress of campaigns on the terminal."""

import sys
from collections.abc import Callable


def progress_line(what: str, of: str = "throws") -> Callable[[int, int], None]:
    """Show progress on stderr: in place on a terminal, else one line per tenth."""
    live = sys.stderr.isatty()
    shown = -1

    def show(done: int, total: int) -> None:
        nonlocal shown
        step = done * 10 // max(total, 1)
        if live:
            end = "\n" if done == total else ""
            sys.stderr.write(f"\r{what}: {done} of {total} {of}{end}")
        elif step != shown:
            sys.stderr.write(f"{what}: {done} of {total} {of}\n")
        sys.stderr.flush()
        shown = step

    return show
