"""Makes the driver that the command line names: ``package.module:Class`` with keyword options."""

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any, cast

from machine.errors import UsageError
from runtime.driver import Driver
from runtime.driver_factory import DRIVER_PARTS, check_parts, construct


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
    wanted = _parameters(factory)
    if "count" in wanted:
        arguments.setdefault("count", 1)
    if "unit_seed" in wanted:
        arguments.setdefault("unit_seed", unit_seed)
    driver = construct(factory, arguments, f"driver {name}")
    check_parts(driver, DRIVER_PARTS, f"driver {name}")
    driver = cast("Driver", driver)
    if driver.count != 1:
        raise UsageError(
            f"{name} serves {driver.count} machines; a machine process needs exactly one"
        )
    return driver


def _parameters(factory: Callable[..., object]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return {}
