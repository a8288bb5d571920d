"""Every numeric field of a message, spec, card, setting, table or log row carries its unit."""

import importlib
import pkgutil
import types
import typing

import numpy as np
from pydantic import BaseModel

from machine.conventions import UNIT_SUFFIXES
from machine.telemetry import CONTROL_ROW, POLICY_ROW
from tests.source_tree import packages

FOREIGN = {
    "server.viewer_proxy.frames",  # the 3D view's own protocol
    "diagnosis.verdict",  # a published shape: the unit stands beside the value or in the name around it
    "diagnosis.identification.quantity",  # likewise
    "evaluation.measures",  # the published names of `downrange evaluate --json`, with intervals
    "diagnosis.healthy.noise",  # numbers of a channel, each in that channel's unit
    "diagnosis.healthy.filters",  # learned weights over inputs of many units
}
"""Modules whose field names are fixed elsewhere, or have no one unit."""
SEEDS = {"seed", "unit_seed", "unit_seeds"}
"""Names of random streams: numbers that measure nothing."""
KEYED = {"best", "plot", "training"}
"""Numbers by name, where the name in the key carries the unit."""

VECTORS = {"observations", "actions", "tolerance"}
"""Vectors of a policy, whose entries have units of their own."""
BESIDE = {"value", "ci95", "limit", "a", "b", "difference"}
"""Numbers whose unit follows from the field `unit` or `quantity` beside them."""
PER_TARGET = {"throws_per_target", "unseen_throws_per_target"}


def models() -> list[type[BaseModel]]:
    found: dict[str, type[BaseModel]] = {}
    for package in packages():
        for module in pkgutil.walk_packages(
            importlib.import_module(package).__path__, f"{package}."
        ):
            if module.name in FOREIGN:
                continue
            for item in vars(importlib.import_module(module.name)).values():
                if (
                    isinstance(item, type)
                    and issubclass(item, BaseModel)
                    and item.__module__ == module.name
                ):
                    found[f"{module.name}.{item.__name__}"] = item
    return list(found.values())


def is_numeric(annotation: object) -> bool:
    if annotation in (int, float):
        return True
    if typing.get_origin(annotation) is typing.Literal:
        return False
    if typing.get_origin(annotation) in (
        tuple,
        list,
        dict,
        typing.Union,
        types.UnionType,
        typing.Annotated,
    ):
        return any(is_numeric(part) for part in typing.get_args(annotation))
    return False


def test_numeric_fields_of_models_end_with_a_unit():
    without = [
        f"{model.__module__}.{model.__name__}.{name}"
        for model in models()
        for name, field in model.model_fields.items()
        if is_numeric(field.annotation)
        and not name.endswith(UNIT_SUFFIXES)
        and name not in SEEDS | KEYED | VECTORS | PER_TARGET
        and not (name in BESIDE and {"unit", "quantity"} & set(model.model_fields))
    ]
    assert without == [], "see UNIT_SUFFIXES in machine/conventions.py"


def test_columns_of_log_rows_end_with_a_unit():
    without = [
        name
        for row in (CONTROL_ROW, POLICY_ROW)
        for name in row.names or ()
        if row[name].base.kind in "fiu"
        and row[name].base != np.bool_
        and not name.endswith(UNIT_SUFFIXES)
    ]
    assert without == [], "see UNIT_SUFFIXES in machine/conventions.py"
