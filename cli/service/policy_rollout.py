"""`downrange policy rollout`: bring a version to machines in stages, through a running server."""

from typing import Annotated, Any, Literal

import tyro

from cli.service.policy_choice import choose_policy
from cli.service.throw_client import USUAL_LOGIN, Login, ThrowClient
from machine.errors import UsageError

USUAL_USER = "admin"
OPEN = ("running", "paused")
WANTED = {
    "pause": ("paused",),
    "abort": ("aborted", "rolled_back"),
}
"""States that are what an action asked for; of all others ON_COURSE is."""
ON_COURSE = ("running", "completed")


def rollout(
    action: Annotated[
        Literal["start", "status", "pause", "resume", "promote", "abort"], tyro.conf.Positional
    ],
    /,
    *,
    policy: str | None = None,
    stage: tuple[str, ...] = (),
    mode: Literal["2d", "3d"] | None = None,
    reason: str | None = None,
    throws: int = 12,
    deadline_s: Annotated[float, tyro.conf.arg(name="deadline")] = 600.0,
    login: Login = USUAL_LOGIN,
) -> int:
    """Bring a version to machines in stages; exit 3 when the rollout is not as the action wants it.

    For pause that is paused, for abort aborted, for the others running or completed.

    Example: downrange policy rollout start --policy m545-2d-v8 --stage m001 tag:yard --reason "new"

    A stage ends when every machine has thrown often enough, and no worse than before or than the gates.

    Args:
        action: start, status, pause, resume, promote (ends the stage), or abort (takes machines back).
        policy: to start: id of the version, or the beginning of its sha256.
        stage: to start: a stage each, machines and tags separated by commas, for example m001,tag:yard.
        mode: of the open rollout, where both modes have one.
        reason: why, for the history; needed for all but status.
        throws: to start: measured throws of each machine.
        deadline_s: to start: within which a machine has to switch.
        login: which server, and by which account.
    """
    if action != "status" and reason is None:
        raise UsageError(f"`rollout {action}` needs --reason, for the history")
    with login.open(USUAL_USER) as client:
        if action == "start":
            found = _start(client, policy, stage, reason, throws, deadline_s)
        else:
            found = _chosen(client, mode, is_open=action != "status")
            if found is None:
                print("there was no rollout yet")
                return 0
            if action != "status":
                path = f"/policy-rollouts/{found['rollout_id']}/change/{action}"
                found = client.call("POST", path, {"reason": reason})
    for line in rollout_lines(found):
        print(line)
    return 0 if found["state"] in WANTED.get(action, ON_COURSE) else 3


def _start(
    client: ThrowClient,
    policy: str | None,
    stage: tuple[str, ...],
    reason: str | None,
    throws: int,
    deadline_s: float,
) -> dict[str, Any]:
    if policy is None or not stage:
        raise UsageError("`rollout start` needs --policy and --stage")
    chosen = choose_policy(client.call("GET", "/policies"), policy)
    stages: list[dict[str, list[str]]] = []
    for text in stage:
        names = [name.strip() for name in text.split(",") if name.strip()]
        tags = [name.removeprefix("tag:") for name in names if name.startswith("tag:")]
        machines = [name for name in names if not name.startswith("tag:")]
        stages.append({"machine_ids": machines, "tags": tags})
    body = {
        "policy_sha256": chosen["policy_sha256"],
        "reason": reason,
        "stages": stages,
        "throws_count": throws,
        "deadline_s": deadline_s,
    }
    return client.call("POST", f"/policy-rollouts/{chosen['mode']}/start", body)


def _chosen(client: ThrowClient, mode: str | None, *, is_open: bool) -> dict[str, Any] | None:
    rows = [row for row in client.call("GET", "/policy-rollouts") if mode in (None, row["mode"])]
    found = [row for row in rows if row["state"] in OPEN]
    if len(found) > 1:
        raise UsageError("both modes have an open rollout; say which by --mode")
    if found:
        return found[0]
    if is_open:
        raise UsageError("no rollout is open")
    return rows[0] if rows else None


def rollout_lines(found: dict[str, Any]) -> list[str]:
    """A rollout for a terminal: its state, machines by stage, and what happened."""
    last = found["steps"][-1]
    lines = [
        f"{found['policy_id']} in {found['mode']}: {found['state'].replace('_', ' ')}, stage "
        f"{found['stage_count'] + 1} of {len(found['stages'])}",
        last["sentence"],
        f"{'machine':<10} {'stage':>5}  {'state':<8} {'throws':>6}  {'along: mean, sd':>20}  "
        f"{'across: mean, sd':>20}  {'before, along: mean, sd':>24}",
    ]
    for machine in found["machines"]:
        since, before = machine["since"], machine["before"]
        lines.append(
            f"{machine['machine_id']:<10} {machine['stage_count'] + 1:>5}  {machine['state']:<8} "
            f"{0 if since is None else since['throw_count']:>6}  {_pair(since, 'downrange'):>20}  "
            f"{_pair(since, 'crossrange'):>20}  {_pair(before, 'downrange'):>24}  "
            f"{machine['sentence']}".rstrip()
        )
    lines += [
        f"{step['at_utc']}  {step['state']:<11}  {step['actor']}: {step['sentence']}"
        for step in found["steps"]
    ]
    return lines


def _pair(figures: dict[str, Any] | None, way: str) -> str:
    if figures is None:
        return "-"
    mean, sd = figures[f"mean_{way}_error_m"]["value"], figures[f"sd_{way}_m"]["value"]
    return f"{'-' if mean is None else f'{mean:+.3f}'}, {'-' if sd is None else f'{sd:.3f}'}"
