"""Ranges of the training's response from what `downrange identify response --json` wrote, one file a machine.

It reads, merges and has them stretched as the built-in ranges are. It refuses files that are not such
results, numbers that no machine has, and ranges that the simulator cannot hold.
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
from training.environment.shipped import RESPONSE_WIDENING_RATIO
from training.environment.state import DELAY_TICKS
from training.environment.task import Range, ResponseConfig, widened

LONGEST_DEAD_TIME_S = round((DELAY_TICKS - 1) * CONTROL_PERIOD_S, 3)
"""What the simulator's delay line holds."""
HIGHEST_NATURAL_FREQUENCY_RAD_PER_S = 2.0 / CONTROL_PERIOD_S
"""With w h < 2 one step of `training.environment.dynamics.respond` is stable whatever the damping."""
SMALLEST_LAG_S = min(ResponseConfig().lag_min_s)
"""Stands for no first-order lag at all: the identified model has none."""
NO_PUSH = (0.0, 0.0)


@dataclass(frozen=True)
class _Number:
    """One number of a joint: what people call it, its fields in the configuration, its bounds."""

    label: str
    field: str
    """Of `ResponseConfig`, with ``{}`` for min and max."""
    unit: str = ""
    limit: float = math.inf
    """Largest that the simulator holds."""


DYNAMICS = {
    "dead_time_s": _Number("dead time", "dead_time_{}_s", " s", LONGEST_DEAD_TIME_S),
    "natural_frequency_rad_per_s": _Number(
        "natural frequency",
        "natural_frequency_{}_rad_per_s",
        " rad/s",
        HIGHEST_NATURAL_FREQUENCY_RAD_PER_S,
    ),
    "damping_ratio": _Number("damping", "damping_{}_ratio"),
}
"""The three that belong together: one alone says nothing where the model has a further lag."""
GAINS = {
    "gain_positive_ratio": _Number("gain positive", "gain_positive_{}_ratio"),
    "gain_negative_ratio": _Number("gain negative", "gain_negative_{}_ratio"),
}
NUMBERS = {**DYNAMICS, **GAINS}
PUSHES = {"boom": "boom_from_dipper_ratio", "dipper": "dipper_from_boom_ratio"}
"""What of the other's acceleration a joint feels; the identified model has it inside its own numbers."""
REMEDY = (
    "write the file anew with `downrange identify response LOG... --json FILE`, "
    "or put a sentence in the range's place to keep the built-in one"
)


@dataclass(frozen=True)
class ResponseSource:
    """Where ranges came from, as the policy's card names it."""

    file: str
    machine_id: str
    sha256: str


@dataclass(frozen=True)
class ResponseFile:
    """What one file knows."""

    source: ResponseSource
    known: Mapping[str, Mapping[str, Range]]
    """By joint and number; what is not there cannot be known from the machine's logs."""


@dataclass(frozen=True)
class IdentifiedResponse:
    """The response that training draws from."""

    response: ResponseConfig
    lines: tuple[str, ...]
    """One for people a joint: what comes from the files, what stays built in."""


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
        UsageError: it is missing, no result of `identify response`, or one of its numbers cannot be; with
            file, number, cause and remedy.
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
        # The branches of "two numbers or a sentence" are pydantic's names, not the file's.
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
    for joint, numbers in training.items():
        if joint not in ACTIVE_JOINTS:
            raise UsageError(
                f"{path}: no joint is called '{joint}', only {', '.join(ACTIVE_JOINTS)}; {REMEDY}"
            )
        known[joint] = {}
        for name, value in numbers.items():
            if name not in NUMBERS:
                raise UsageError(
                    f"{path}: {joint} has no '{name}', only {', '.join(NUMBERS)}; {REMEDY}"
                )
            if not isinstance(value, str):
                _check_range(f"{path}: {joint} {name}", NUMBERS[name], value)
                known[joint][name] = value
    if not any(known.values()):
        raise UsageError(
            f"{path} knows no number for training; identify it from throws "
            "(`downrange record --mode 2d`, 40 or more): valve steps bypass the velocity controller"
        )
    return known


def _check_range(where: str, number: _Number, value: Range) -> None:
    low, high = value
    told = f"{low:g} to {high:g}{number.unit}"
    if not (math.isfinite(low) and math.isfinite(high)):
        raise UsageError(f"{where}: {told} is not a range of numbers; {REMEDY}")
    if low > high:
        raise UsageError(
            f"{where}: {told} runs downwards, the two are swapped; write the lower first"
        )
    if low < 0.0 or (low == 0.0 and number is not NUMBERS["dead_time_s"]):
        raise UsageError(f"{where}: {told} begins where no machine is; {REMEDY}")
    if high > number.limit:
        raise UsageError(
            f"{where}: {told} goes beyond the {number.limit:g}{number.unit} that the training's "
            f"simulator holds; {REMEDY}"
        )


def with_identified(built_in: ResponseConfig, files: Sequence[ResponseFile]) -> IdentifiedResponse:
    """The built-in response with what the files know in its place, stretched as that is.

    A range goes from the smallest low to the largest high of the files that know it. A joint's dead time,
    natural frequency and damping are taken if a file knows all three. It then has neither first-order lag
    nor push of its neighbour, since the identified model has neither.

    Args:
        built_in: as the task has it, stretched already.
        files: one a machine.

    Raises:
        UsageError: nothing of the files can be used, or a stretched range reaches zero.
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
    """Ranges of one joint that are used, not yet stretched."""
    known = [file.known.get(joint, {}) for file in files]
    whole = any(DYNAMICS.keys() <= numbers.keys() for numbers in known)
    taken: dict[str, Range] = {}
    for name in NUMBERS:
        ranges = [numbers[name] for numbers in known if name in numbers]
        if ranges and (whole or name in GAINS):
            taken[name] = (min(low for low, _ in ranges), max(high for _, high in ranges))
    return taken


def _stretched(
    built_in: ResponseConfig, taken: Mapping[str, Mapping[str, Range]]
) -> ResponseConfig:
    narrow = built_in
    for index, joint in enumerate(ACTIVE_JOINTS):
        for name, (low, high) in taken[joint].items():
            narrow = _with(narrow, NUMBERS[name].field, index, low, high)
    wide = widened(narrow, RESPONSE_WIDENING_RATIO)
    response = built_in
    for index, joint in enumerate(ACTIVE_JOINTS):
        for name in taken[joint]:
            number = NUMBERS[name]
            low, high = _range(wide, number.field, index)
            given = _range(narrow, number.field, index)
            # `widened` stops at 0.001; a dead time may be that short.
            if low < given[0] and low <= 0.001 and name != "dead_time_s":
                raise UsageError(
                    f"{joint} {name}: {given[0]:g} to {given[1]:g}{number.unit} over all files, stretched "
                    f"{RESPONSE_WIDENING_RATIO:g} times, reaches zero; identify from more throws or {REMEDY}"
                )
            high = max(low, min(high, number.limit))
            response = _with(response, number.field, index, low, high)
        if DYNAMICS.keys() <= taken[joint].keys():
            response = _with(response, "lag_{}_s", index, SMALLEST_LAG_S, SMALLEST_LAG_S)
            if joint in PUSHES:
                response = replace(response, **{PUSHES[joint]: NO_PUSH})
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
        low, high = _range(response, NUMBERS[name].field, index)
        parts.append(f"{NUMBERS[name].label} {low:.3g}..{high:.3g}{NUMBERS[name].unit}")
    kept = [number.label for name, number in NUMBERS.items() if name not in taken]
    push = ["push of its neighbour"] if joint in PUSHES else []
    if DYNAMICS.keys() <= taken.keys():
        parts += [f"no lag ({SMALLEST_LAG_S:g} s)", *(f"no {what}" for what in push)]
    else:
        kept += ["lag", *push]
    told = [f"from the files {', '.join(parts)}"] if parts else []
    told += [f"built in {', '.join(kept)}"] if kept else []
    return f"{joint}: {'; '.join(told)}"
