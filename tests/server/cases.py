"""One test for many cases: all cases are tried, and all that fail are listed."""

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any

import pytest


def each_case(names: str | tuple[str, ...], cases: Iterable[Any]) -> Callable[[Any], Any]:
    """Decorate a test like `pytest.mark.parametrize`, but as one test item.

    Fixtures are shared by the cases, so a case must not depend on what an earlier one left.
    """
    keys = tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names
    listed = list(cases)

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(*args: Any, **fixtures: Any) -> None:
            failures: list[str] = []
            for case in listed:
                values = (case,) if len(keys) == 1 else tuple(case)
                try:
                    test(*args, **fixtures, **dict(zip(keys, values, strict=True)))
                except (Exception, pytest.fail.Exception) as error:
                    failures.append(f"{case!r}: {type(error).__name__}: {error}")
            assert not failures, "\n".join([f"{len(failures)} of {len(listed)} cases:", *failures])

        signature = inspect.signature(test)
        kept = [p for name, p in signature.parameters.items() if name not in keys]
        run.__dict__["__signature__"] = signature.replace(parameters=kept)
        return run

    return decorate
