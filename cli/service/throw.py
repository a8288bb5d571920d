"""`downrange throw`: one throw through a running server, the way the console does it."""

import json
import math
from dataclasses import asdict
from typing import Annotated, Literal

import tyro

from cli.service.throw_client import USUAL_LOGIN, Login, ThrowReport
from machine.conventions import DEFAULT_PACE_RATIO
from machine.errors import UsageError
from machine.reach import check_pace


def run(
    *,
    target: str,
    machine: str = "m001",
    mode: Literal["2d", "3d"] = "2d",
    height: float = 0.0,
    pace: float = DEFAULT_PACE_RATIO,
    timeout_s: Annotated[float, tyro.conf.arg(name="timeout")] = 60.0,
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
    login: Login = USUAL_LOGIN,
) -> int:
    """Preview, arm, hold and throw; exit 0 when the load landed, 3 when the throw ended otherwise.

    The account is the given one, else DOWNRANGE_USER and DOWNRANGE_PASSWORD_FILE, else `operator` of
    data/demo-login.txt.

    Args:
        target: range along the machine's x axis, or range and crossrange (left), as in 9.0 or 9.0,-0.5; m.
        machine: machine id.
        mode: 2d (arm plane) or 3d (with the cabin turning).
        height: of the target above ground, m; what lies there is described as the machine's site.
        pace: 0 careful .. 1 fast, for policies that were trained with a pace.
        timeout_s: how long to wait for the throw to end.
        as_json: print one line of JSON instead of words.
        login: which server, and by which account.
    """
    x_m, y_m = parse_target(target)
    check_pace(pace)
    if not -5.0 <= height <= 10.0:
        raise UsageError(f"--height {height:g}: targets lie between -5 and 10 m")
    with login.open("operator") as client:
        report = client.throw(machine, mode, (x_m, y_m, height), timeout_s, pace)
    print(json.dumps(asdict(report)) if as_json else in_words(report))
    return 0 if report.state == "landed" else 3


def parse_target(text: str) -> tuple[float, float]:
    """Range and crossrange, m.

    Raises:
        UsageError: not one or two finite numbers.
    """
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(math.isfinite(value) for value in values):
        raise UsageError(
            f"--target {text!r} is not RANGE or RANGE,CROSSRANGE in metres, as in 9.0,-0.5"
        )
    return values[0], values[1] if len(values) == 2 else 0.0


def in_words(report: ThrowReport) -> str:
    """The report for people."""
    lines = [f"throw {report.throw_id}: {report.state}, {report.seconds:.1f} s"]
    for label, errors in (("predicted", report.predicted), ("impact", report.impact)):
        down, cross = errors.get("downrange_error_m"), errors.get("crossrange_error_m")
        if down is not None and cross is not None:
            along = _side(down, "long", "short", "on range")
            lines.append(f"{label}: {along}, {_side(cross, 'left', 'right', 'on line')}")
    return "\n".join(lines)


def _side(error_m: float, positive: str, negative: str, zero: str) -> str:
    if abs(error_m) < 0.005:
        return f"0.00 m {zero}"
    return f"{error_m:+.2f} m {positive if error_m > 0.0 else negative}"
