"""`downrange policy validate`: start or follow a validation at a running server."""

import time
from typing import Any, Literal

from cli.service.policy_choice import choose_policy
from cli.service.throw_client import USUAL_LOGIN, Login, ThrowClient

USUAL_USER = "admin"
POLL_PERIOD_S = 0.5
OPEN = ("queued", "running")


def validate(
    *,
    policy: str,
    protocol: Literal["short", "full"] = "short",
    throws: int | None = None,
    units: int | None = None,
    cancel: bool = False,
    login: Login = USUAL_LOGIN,
) -> int:
    """Throw with a version in virtual machines beside the active one; exit 3 when a gate is not passed.

    Follows a validation of the version that is open already. Ctrl-C stops following; the server goes on.

    Args:
        policy: id of the version, or the beginning of its sha256.
        protocol: short takes minutes; full takes the paper's targets and throws.
        throws: throws at each target, instead of the protocol's.
        units: machines that served no training, instead of the protocol's.
        cancel: stop the open validation instead.
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        chosen = choose_policy(client.call("GET", "/policies"), policy)
        path = f"/policies/{chosen['policy_sha256']}/validation"
        if cancel:
            client.call("DELETE", path)
            print(f"{chosen['policy_id']}: validation cancelled")
            return 0
        found = client.call("GET", path)
        if found is None or found["state"] not in OPEN:
            wish = {"throws_per_target": throws, "unseen_unit_count": units}
            body = {"protocol": protocol, **{k: v for k, v in wish.items() if v is not None}}
            found = client.call("POST", path, body)
        try:
            found = _follow(client, path, found)
        except KeyboardInterrupt:
            print("the server goes on; --cancel stops it")
            return 3
    for line in validation_lines(found):
        print(line)
    return 0 if found["is_passed"] else 3


def _follow(client: ThrowClient, path: str, found: dict[str, Any]) -> dict[str, Any]:
    shown = ""
    while found["state"] in OPEN:
        text = f"{found['progress_ratio']:4.0%}  {found['step']}"
        if text != shown:
            print(text, flush=True)
            shown = text
        time.sleep(POLL_PERIOD_S)
        found = client.call("GET", path)
    return found


def validation_lines(found: dict[str, Any]) -> list[str]:
    """The result for a terminal: gates, failed throws, and the verdict."""
    result = found["result"]
    if result is None:
        return [f"{found['policy_id']}: validation {found['state']} {found['detail']}".rstrip()]
    plan = result["plan"]
    lines = [
        f"{found['policy_id']}: {plan['throws_per_target']} throws at each of {len(plan['ranges_m'])} "
        f"targets, virtual machines {', '.join(str(u) for u in plan['unit_seeds'])}, seed {plan['seed']}",
        f"{'gate':<38} {'measured':>9}  {'95 % interval':>18}  {'limit':>12}",
    ]
    for check in result["checks"]:
        interval = check["ci95"]
        shown = "" if interval is None else f"{interval[0]:.3f} to {interval[1]:.3f}"
        value = "-" if check["value"] is None else _number(check["value"], check["unit"])
        limit = f"{'>=' if check['is_minimum'] else '<='} {_number(check['limit'], check['unit'])}"
        word = "passed" if check["is_passed"] else "NOT PASSED"
        lines.append(
            f"{check['name']:<38} {value:>9}  {shown:>18}  {limit:>12}  {word}  {check['where']}"
        )
    for version in (result["candidate"], result["active"]):
        for unit in version["units"] if version else ():
            lines += [
                f"{version['policy_id']}, virtual machine {unit['unit_seed']}, throw {failure['number']} at "
                f"{failure['range_m']:g} m: {failure['outcome']}"
                for failure in unit["failures"]
            ]
    lines.append(f"{found['policy_id']}: {'passed' if found['is_passed'] else 'NOT PASSED'}")
    return lines


def _number(value: float, unit: str) -> str:
    return f"{value * 1e3:.3g} ms" if unit == "s" else f"{value:.3f}"
