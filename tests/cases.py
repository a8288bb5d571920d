"""One test item for many cases: all of them run, and the failure lists every case that fails."""

import functools
import inspect
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest


def each(
    names: str | tuple[str, ...], values: Iterable[Any], *, copied: str | None = None
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Like pytest.mark.parametrize with these argument names and values, in one test item.

    Cases share the test's fixtures: not for tests that change one, but for the folder that the fixture
    `copied` names, of which every case gets a copy of the same name.
    """
    listed = names.split(",") if isinstance(names, str) else names
    arguments = [name.strip() for name in listed]
    cases = [tuple(value) if len(arguments) > 1 else (value,) for value in values]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(**fixtures: Any) -> None:
            failures: list[str] = []
            for case in cases:
                given = dict(zip(arguments, case, strict=True))
                own = {} if copied is None else {copied: _copy_of(fixtures[copied])}
                try:
                    test(**{**fixtures, **own}, **given)
                except (Exception, pytest.fail.Exception) as error:
                    text = str(error) or type(error).__name__
                    failures.append(f"{given}: {text}")
            if failures:
                text = "\n".join(failures)
                raise AssertionError(f"{len(failures)} of {len(cases)} cases fail:\n{text}")

        signature = inspect.signature(test)
        left = [p for name, p in signature.parameters.items() if name not in arguments]
        run.__signature__ = signature.replace(parameters=left)  # pyright: ignore
        return run

    return decorate


def _copy_of(folder: Path) -> Path:
    beside = tempfile.mkdtemp(dir=folder.parent)
    return Path(shutil.copytree(folder, Path(beside) / folder.name))
