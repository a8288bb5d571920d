"""Response ranges for training from results of `downrange identify response --json`, one file per machine.

The ranges of all files are merged and stretched like the built-in ones. Refused are files that are not such
results, values that are impossible for a machine, and ranges beyond the simulator's limits.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S
from machine.errors import UsageError
from training.environment.configurations import RESPONSE_WIDENING_RATIO
from training.environment.state import DELAY_TICKS
from training.environment.task import Range, ResponseConfig, widened

LONGEST_DEAD_TIME_S = round((DELAY_TICKS - 1) * CONTROL_PERIOD_S, 3)
"""Length of the simulator's delay line."""
HIGHEST_NATURAL_FREQUENCY_RAD_PER_S = 2.0 / CONTROL_PERIOD_S
"""With w h < 2 a step of `training.environment.dynamics.respond` is stable for any damping."""
SMALLEST_LAG_S = min(ResponseConfig().lag_min_s)
"""First-order lag of an identified response, whose model has none."""
NO_REACTION = (0.0, 0.0)
"""Reaction between boom and dipper of an identified response, whose model has none."""


@dataclass(frozen=True)
class _Parameter:
    """Response parameter of a joint: its label, its fields in the configuration, its bound."""

    label: str
    field: str
    """Field of `ResponseConfig`, with ``{}`` for min and max."""
    unit: str = ""
    limit: float = math.inf
    """Largest value that the simulator supports."""


DYNAMICS = {
    "dead_time_s": _Parameter("dead time", "dead_time_{}_s", " s", LONGEST_DEAD_TIME_S),
    "natural_frequency_rad_per_s": _Parameter(
        "natural frequency",
        "natural_frequency_{}_rad_per_s",
        " rad/s",
        HIGHEST_NATURAL_FREQUENCY_RAD_PER_S,
    ),
    "damping_ratio": _Parameter("damping", "damping_{}_ratio"),
}
"""Used only together: the identified model has no first-order lag, so that one of them alone would be
combined with a lag that it already contains."""
GAINS = {
    "gain_positive_ratio": _Parameter("gain positive", "gain_positive_{}_ratio"),
    "gain_negative_ratio": _Parameter("gain negative", "gain_negative_{}_ratio"),
}
PARAMETERS = {**DYNAMICS, **GAINS}
REACTIONS = {"boom": "boom_from_dipper_ratio", "dipper": "dipper_from_boom_ratio"}
"""Fields of the reaction between boom and dipper, which identified parameters contain already."""
REMEDY = (
    "write the file again with `downrange identify response LOG... --json FILE`, "
    "or replace the range by a sentence to keep the built-in one"
)


@dataclass(frozen=True)
class ResponseSource:
    """Source of identified ranges, recorded in the policy's card."""

    file: str
    machine_id: str
    sha256: str


@dataclass(frozen=True)
class ResponseFile:
    """Ranges of one file."""

    source: ResponseSource
    known: Mapping[str, Mapping[str, Range]]
    """By joint and parameter; a missing one could not be identified from the machine's logs."""


@dataclass(frozen=True)
class IdentifiedResponse:
    """Response ranges of a training."""

    response: ResponseConfig
    lines: tuple[str, ...]
    """One line of text per joint: parameters from the files, and built-in ones."""


class _Result(BaseModel):
    model_config = ConfigDict(strict=True)
    training: dict[str, dict[str, tuple[float, float] | str]]


class _File(BaseModel):
    model_config = ConfigDict(strict=True)
    machine_id: str
    result: _Result


def read_response(path: Path) -> ResponseFile:
    """Read and check one file.

    Raises:
        UsageError: the file is missing, is no result of `identify response`, or holds an impossible value;
            with file, parameter, cause and remedy.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"response {path} cannot be read ({error.strerror}); "
            "`downrange identify response LOG... --json FILE` writes one"
        ) from error
    try:
        found = _File.model_validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        # Parts with "tuple[" are pydantic's names of union branches, not keys of the file.
        where = ".".join(str(part) for part in first["loc"] if "tuple[" not in str(part))
        raise UsageError(
            f"{path} is not a result of `downrange identify response` "
            f"({where or 'content'}: {first['msg']}); {REMEDY}"
        ) from error
    sha256 = hashlib.sha256(content).hexdigest()
    source = ResponseSource(path.name, found.machine_id, sha256)
    return ResponseFile(source, _known(path, found.result.training))


def _known(
    path: Path, training: Mapping[str, Mapping[str, Range | str]]
) -> dict[str, dict[str, Range]]:
    known: dict[str, dict[str, Range]] = {}
    for joint, ranges in training.items():
        if joint not in ACTIVE_JOINTS:
            raise UsageError(
                f"{path}: no joint is called '{joint}', only {', '.join(ACTIVE_JOINTS)}; {REMEDY}"
            )
        known[joint] = {}
        for name, value in ranges.items():
            if name not in PARAMETERS:
                raise UsageError(
                    f"{path}: {joint} has no '{name}', only {', '.join(PARAMETERS)}; {REMEDY}"
                )
            if not isinstance(value, str):
                _check_range(f"{path}: {joint} {name}", PARAMETERS[name], value)
                known[joint][name] = value
    if not any(known.values()):
        raise UsageError(
            f"{path} holds no range for training; identify it from throws "
            "(`downrange record --mode 2d`, 40 or more): valve steps bypass the velocity controller"
        )
    return known


def _check_range(where: str, parameter: _Parameter, value: Range) -> None:
    low, high = value
    shown = f"{low:g} to {high:g}{parameter.unit}"
    if not (math.isfinite(low) and math.isfinite(high)):
        raise UsageError(f"{where}: {shown} is not a range of numbers; {REMEDY}")
    if low > high:
        raise UsageError(f"{where}: {shown}: the bounds are swapped; write the lower one first")
    if low < 0.0 or (low == 0.0 and parameter is not PARAMETERS["dead_time_s"]):
        raise UsageError(f"{where}: {shown}: the lower bound must be positive; {REMEDY}")
    if high > parameter.limit:
        raise UsageError(
            f"{where}: {shown} goes beyond the {parameter.limit:g}{parameter.unit} that the training's "
            f"simulator supports; {REMEDY}"
        )


def with_identified(built_in: ResponseConfig, files: Sequence[ResponseFile]) -> IdentifiedResponse:
    """The built-in response with identified ranges in place of its own, stretched in the same way.

    A range extends from the smallest to the largest bound in the files that hold it. A joint's dead time,
    natural frequency and damping are used if one file holds all three. The joint then has no first-order
    lag and no reaction, since the identified model has neither.

    Args:
        built_in: the task's response, stretched already.
        files: one per machine.

    Raises:
        UsageError: no range of the files can be used, or a stretched range reaches zero.
    """
    taken = {joint: _taken(joint, files) for joint in ACTIVE_JOINTS}
    if not any(taken.values()):
        raise UsageError(
            f"{', '.join(f.source.file for f in files)}: of no joint all of "
            f"{', '.join(n.label for n in DYNAMICS.values())} are known, nor a gain; identify from "
            "more throws, or leave --response out"
        )
    response = _stretched(built_in, taken)
    lines = tuple(_line(joint, response, taken[joint]) for joint in ACTIVE_JOINTS)
    return IdentifiedResponse(response, lines)


def _taken(joint: str, files: Sequence[ResponseFile]) -> dict[str, Range]:
    """Ranges of one joint that are used, before stretching."""
    known = [file.known.get(joint, {}) for file in files]
    whole = any(DYNAMICS.keys() <= item.keys() for item in known)
    taken: dict[str, Range] = {}
    for name in PARAMETERS:
        ranges = [item[name] for item in known if name in item]
        if ranges and (whole or name in GAINS):
            taken[name] = (min(low for low, _ in ranges), max(high for _, high in ranges))
    return taken


def _stretched(
    built_in: ResponseConfig, taken: Mapping[str, Mapping[str, Range]]
) -> ResponseConfig:
    narrow = built_in
    for index, joint in enumerate(ACTIVE_JOINTS):
        for name, (low, high) in taken[joint].items():
            narrow = _with(narrow, PARAMETERS[name].field, index, low, high)
    wide = widened(narrow, RESPONSE_WIDENING_RATIO)
    response = built_in
    for index, joint in enumerate(ACTIVE_JOINTS):
        for name in taken[joint]:
            parameter = PARAMETERS[name]
            low, high = _range(wide, parameter.field, index)
            given = _range(narrow, parameter.field, index)
            # `widened` stops at 0.001; a dead time may be that short.
            if low < given[0] and low <= 0.001 and name != "dead_time_s":
                raise UsageError(
                    f"{joint} {name}: {given[0]:g} to {given[1]:g}{parameter.unit} over all files, stretched "
                    f"{RESPONSE_WIDENING_RATIO:g} times, reaches zero; identify from more throws or {REMEDY}"
                )
            high = max(low, min(high, parameter.limit))
            response = _with(response, parameter.field, index, low, high)
        if DYNAMICS.keys() <= taken[joint].keys():
            response = _with(response, "lag_{}_s", index, SMALLEST_LAG_S, SMALLEST_LAG_S)
            if joint in REACTIONS:
                response = replace(response, **{REACTIONS[joint]: NO_REACTION})
    return response


def _range(response: ResponseConfig, field: str, index: int) -> Range:
    values = asdict(response)
    return values[field.format("min")][index], values[field.format("max")][index]


def _with(
    response: ResponseConfig, field: str, index: int, low: float, high: float
) -> ResponseConfig:
    values, changed = asdict(response), dict[str, Any]()
    for name, value in ((field.format("min"), low), (field.format("max"), high)):
        four = list(values[name])
        four[index] = value
        changed[name] = tuple(four)
    return replace(response, **changed)


def _line(joint: str, response: ResponseConfig, taken: Mapping[str, Range]) -> str:
    index = ACTIVE_JOINTS.index(joint)
    parts: list[str] = []
    for name in taken:
        low, high = _range(response, PARAMETERS[name].field, index)
        parts.append(f"{PARAMETERS[name].label} {low:.3g}..{high:.3g}{PARAMETERS[name].unit}")
    kept = [parameter.label for name, parameter in PARAMETERS.items() if name not in taken]
    reaction = ["reaction of its neighbour"] if joint in REACTIONS else []
    if DYNAMICS.keys() <= taken.keys():
        parts += [f"no lag ({SMALLEST_LAG_S:g} s)", *(f"no {what}" for what in reaction)]
    else:
        kept += ["lag", *reaction]
    sources = [f"from the files {', '.join(parts)}"] if parts else []
    sources += [f"built in {', '.join(kept)}"] if kept else []
    return f"{joint}: {'; '.join(sources)}"
