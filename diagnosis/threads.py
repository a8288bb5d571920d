"""One thread for the linear algebra: the matrices here are small, and idle threads only wait for each other.

With two busy cores OpenBLAS's threads made a diagnosis ten times slower than one thread does.
"""

import ctypes
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

_SUFFIXES = ("64_", "")
_PREFIXES = ("scipy_openblas", "openblas")


@cache
def _libraries() -> tuple[tuple[Any, Any], ...]:
    """Getter and setter of the thread count of every OpenBLAS that is loaded (Linux)."""
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:
        return ()
    paths = {line.split()[-1] for line in maps.splitlines() if "openblas" in line}
    found: list[tuple[Any, Any]] = []
    for path in sorted(paths):
        try:
            library = ctypes.CDLL(path)
        except OSError:
            continue
        for prefix in _PREFIXES:
            for suffix in _SUFFIXES:
                getter = getattr(library, f"{prefix}_get_num_threads{suffix}", None)
                setter = getattr(library, f"{prefix}_set_num_threads{suffix}", None)
                if getter is not None and setter is not None:
                    found.append((getter, setter))
    return tuple(found)


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Limit OpenBLAS to one thread inside; does nothing where there is none."""
    before = [int(getter()) for getter, _ in _libraries()]
    for _, setter in _libraries():
        setter(1)
    try:
        yield
    finally:
        for (_, setter), count in zip(_libraries(), before, strict=True):
            setter(count)
