"""Make a driver of another package; an error names the class, the method and the remedy."""

import inspect
import traceback
from collections.abc import Callable, Mapping
from typing import Any

from machine.errors import DownrangeError, UsageError

DRIVER_PARTS = ("count", "now_ns", "advance", "read", "write", "load", "close")
"""What `runtime.driver.Driver` asks of a class."""
SIMULATED_PARTS = (*DRIVER_PARTS, "reset", "collided")
"""What `runtime.driver.SimulatedDriver` asks of a class."""


def construct(factory: Callable[..., object], arguments: Mapping[str, Any], what: str) -> object:
    """Call a class of another package with keyword arguments.

    Args:
        factory: the class, or a function that returns its instance.
        arguments: keywords by name.
        what: its name in messages, such as ``driver yard_udp:YardMachine``.

    Raises:
        UsageError: the signature does not take the arguments, or the call raised an exception; the message
            then has the exception's type and place.
    """
    given = ", ".join(arguments) or "no arguments"
    try:
        inspect.signature(factory).bind(**arguments)
    except TypeError as error:
        raise UsageError(
            f"{what} cannot be made: its __init__ must take the keywords {given}, and does not ({error}); "
            "change its signature, or the options (docs/drivers.md)"
        ) from error
    except ValueError:
        pass  # A class in C without a signature: the call itself shows whether it fits.
    try:
        return factory(**arguments)
    except DownrangeError:
        raise
    except Exception as error:
        raise UsageError(
            f"{what} cannot be made: its code raised {type(error).__name__}: {error} "
            f"({_place(error)}), called with {dict(arguments)}"
        ) from error


def check_parts(driver: object, parts: tuple[str, ...], what: str) -> None:
    """Refuse an object that lacks methods.

    Raises:
        UsageError: with the names of what is missing.
    """
    missing = [
        part if part == "count" else f"{part}()" for part in parts if not hasattr(driver, part)
    ]
    if missing:
        raise UsageError(
            f"{what} has no {', '.join(missing)}: add what is missing to its class (docs/drivers.md)"
        )


def _place(error: BaseException) -> str:
    """File, line and function in which an exception was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return "place unknown"
    last = frames[-1]
    return f"{last.filename}, line {last.lineno}, in {last.name}"
