"""Makes the driver that the command line names: ``package.module:Class`` with keyword options."""

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

from machine.errors import UsageError
from runtime.driver import Driver


def load_driver(name: str, options: Mapping[str, str], unit_seed: int) -> Driver:
    """Import and make one driver.

    The class is called with `options` as keyword arguments, and with ``count=1`` and ``unit_seed`` where
    its signature has these parameters, as simulated plants do.

    Raises:
        UsageError: it cannot be imported, made, or is no driver.
    """
    module_name, _, class_name = name.partition(":")
    try:
        factory = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"driver {name} cannot be imported ({error}); install its package beside this one, or set "
            "PYTHONPATH"
        ) from error
    arguments: dict[str, Any] = dict(options)
    try:
        wanted = inspect.signature(factory).parameters
        if "count" in wanted:
            arguments.setdefault("count", 1)
        if "unit_seed" in wanted:
            arguments.setdefault("unit_seed", unit_seed)
        driver = factory(**arguments)
    except (TypeError, ValueError, OSError) as error:
        raise UsageError(f"driver {name} cannot be made with {arguments}: {error}") from error
    if not isinstance(driver, Driver):
        missing = [part for part in _PARTS if not hasattr(driver, part)]
        raise UsageError(
            f"{name} is no driver: it has no {', '.join(missing)}; see docs/drivers.md"
        )
    if driver.count != 1:
        raise UsageError(
            f"{name} serves {driver.count} machines; a machine process needs exactly one"
        )
    return driver


_PARTS = ("count", "now_ns", "advance", "read", "write", "load", "close")
