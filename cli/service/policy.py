"""`downrange policy`: which versions there are, and which each machine has; through a running server.

`check` and `compare` read files instead.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from cli.service.policy_choice import choose_policy
from cli.service.policy_rollout import rollout
from cli.service.policy_validation import validate
from cli.service.throw_client import USUAL_LOGIN, Login, ThrowClient
from machine.errors import UsageError
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, read_policy
from machine.spec import load_spec

USUAL_USER = "admin"
POLL_PERIOD_S = 0.2
PENDING = "pending"


def listed(*, login: Login = USUAL_LOGIN) -> int:
    """Show the versions that the server has or ever had.

    Args:
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        for policy in client.call("GET", "/policies"):
            notes = [policy["state"]]
            notes += ["active"] * policy["is_active"] + ["files gone"] * (not policy["is_present"])
            print(
                f"{policy['policy_id']:<24} {policy['mode']}  {policy['policy_sha256'][:12]}  "
                f"{policy['throw_count']:>6} throws  {', '.join(notes)}".rstrip()
            )
    return 0


def approve(
    *,
    policy: str,
    reason: str,
    without_validation: bool = False,
    login: Login = USUAL_LOGIN,
) -> int:
    """Approve a version by the site's key; machines load no other. It needs a validation that passed.

    Args:
        policy: id of the version, or the beginning of its sha256.
        reason: why, for the history.
        without_validation: approve it though no validation of these files passed the gates in force; history
            and audit say so.
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        chosen = choose_policy(client.call("GET", "/policies"), policy)
        body = {"reason": reason, "is_without_validation": without_validation}
        approval = client.call("POST", f"/policies/{chosen['policy_sha256']}/approve", body)
        print(
            f"{chosen['policy_id']}: approved by {approval['approved_by']}, key {approval['key_id']}"
        )
    return 0


def withdraw(
    *,
    policy: str,
    reason: str,
    login: Login = USUAL_LOGIN,
) -> int:
    """Withdraw an approval; machines go back to an approved version before, or have none.

    Args:
        policy: id of the version, or the beginning of its sha256.
        reason: why, for the history.
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        chosen = choose_policy(client.call("GET", "/policies"), policy)
        client.call("POST", f"/policies/{chosen['policy_sha256']}/withdraw", {"reason": reason})
        print(f"{chosen['policy_id']}: no longer approved")
    return 0


def retire(
    *,
    policy: str,
    reason: str,
    login: Login = USUAL_LOGIN,
) -> int:
    """Take a version out of use for good; refused while a machine runs it or may go back to it.

    Args:
        policy: id of the version, or the beginning of its sha256.
        reason: why, for the history.
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        chosen = choose_policy(client.call("GET", "/policies"), policy, has_gone=True)
        client.call("POST", f"/policies/{chosen['policy_sha256']}/retire", {"reason": reason})
        print(f"{chosen['policy_id']}: retired")
    return 0


def add(
    folder: Annotated[Path, tyro.conf.Positional], /, *, reason: str, login: Login = USUAL_LOGIN
) -> int:
    """Upload a version; the server checks it as `downrange policy check` does.

    Example: downrange policy add runs/m545-2d-v8 --reason "retrained with pace" --server URL

    Args:
        folder: of the version, with policy.onnx, card.json and golden_vectors.json.
        reason: why, for the history.
        login: which server, and by which account.
    """
    files = read_policy(folder)
    contents = {POLICY_FILE: files.policy, CARD_FILE: files.text}
    if files.golden is not None:
        contents[GOLDEN_FILE] = files.golden
    with login.open(USUAL_USER) as client:
        added = client.upload("/policies", contents, {"reason": reason})
        print(f"{added['policy_id']}: {added['state']}, version {added['policy_sha256'][:12]}")
    return 0


def check(folder: Annotated[Path, tyro.conf.Positional], /) -> int:
    """Check a version as server and machine do: files, card, network, golden vectors; needs no server.

    Args:
        folder: of the version, with policy.onnx, card.json and golden_vectors.json.
    """
    # The network's runtime takes half a second to load; the other actions do not wait for it.
    from runtime.control.policy_check import check_version

    card = check_version(read_policy(folder), load_spec()).card
    print(f"{card.policy_id} can be used in {card.mode.value}: version {card.policy_sha256[:12]}")
    return 0


def show(
    *,
    policy: str,
    login: Login = USUAL_LOGIN,
) -> int:
    """Show a version and its life: who moved it on, when and why.

    Args:
        policy: id of the version, or the beginning of its sha256.
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        chosen = choose_policy(client.call("GET", "/policies"), policy, has_gone=True)
        card = chosen["card"]
        print(f"{chosen['policy_id']}  {chosen['mode']}  {chosen['state']}")
        print(f"version        {chosen['policy_sha256']}")
        print(f"machine model  {card['model_sha256']}")
        print(f"targets        {card['target_range_min_m']} to {card['target_range_max_m']} m")
        print(f"thrown         {chosen['throw_count']} times")
        if chosen["problem"]:
            print(f"problem        {chosen['problem']}")
        for row in client.call("GET", f"/policies/{chosen['policy_sha256']}/history"):
            note = "without a validation  " * row["evidence"].get("is_without_validation", False)
            print(f"{row['at_utc']}  {row['to_state']:<10}  {note}{row['actor']}: {row['reason']}")
    return 0


def deploy(
    *,
    policy: str,
    machine: str,
    reason: str,
    login: Login = USUAL_LOGIN,
    timeout_s: Annotated[float, tyro.conf.arg(name="timeout")] = 60.0,
) -> int:
    """Ask a machine to switch to a version; exit 3 when it has not, or refused.

    Args:
        policy: id of the version, or the beginning of its sha256.
        machine: machine id.
        reason: why, for the history.
        login: which server, and by which account.
        timeout_s: how long to wait for the machine; it switches later, too.
    """
    with login.open(USUAL_USER) as client:
        chosen = choose_policy(client.call("GET", "/policies"), policy)
        body = {"policy_sha256": chosen["policy_sha256"], "reason": reason}
        path = f"/machines/{machine}/policies/{chosen['mode']}/deploy"
        return _follow(client, client.call("POST", path, body), timeout_s)


def rollback(
    *,
    machine: str,
    mode: Literal["2d", "3d"],
    reason: str,
    login: Login = USUAL_LOGIN,
    timeout_s: Annotated[float, tyro.conf.arg(name="timeout")] = 60.0,
) -> int:
    """Ask a machine to go back to the version it had before; exit 3 when it has not, or refused.

    Args:
        machine: machine id.
        mode: 2d or 3d.
        reason: why, for the history.
        login: which server, and by which account.
        timeout_s: how long to wait for the machine; it switches later, too.
    """
    with login.open(USUAL_USER) as client:
        path = f"/machines/{machine}/policies/{mode}/rollback"
        return _follow(client, client.call("POST", path, {"reason": reason}), timeout_s)


def history(
    *,
    machine: str,
    at: str | None = None,
    login: Login = USUAL_LOGIN,
) -> int:
    """Show what a machine has on board, or had at a time, and who wanted which version when and why.

    Args:
        machine: machine id.
        at: time, ISO 8601, UTC where it names no zone; now without.
        login: which server, and by which account.
    """
    with login.open(USUAL_USER) as client:
        query = f"?at={at.replace('+', '%2B')}" if at else ""
        aboard = client.call("GET", f"/machines/{machine}/policies{query}")
        for row in aboard["policies"]:
            print(
                f"{row['mode']}  {row['policy_id'] or 'no usable policy'}  since {row['since_utc']}"
            )
        if not aboard["policies"]:
            print("the machine had not been started yet")
        if at is None:
            for row in client.call("GET", f"/machines/{machine}/deployments"):
                what = "back to" if row["is_rollback"] else "deploy"
                print(
                    f"{row['created_utc']}  {row['mode']}  {what} {row['policy_id']}  {row['outcome']}  "
                    f"{row['created_by']}: {row['reason']}  {row['detail']}".rstrip()
                )
    return 0


def keys(
    action: Annotated[Literal["list", "rotate", "revoke"], tyro.conf.Positional],
    /,
    *,
    key: str | None = None,
    reason: str | None = None,
    login: Login = USUAL_LOGIN,
) -> int:
    """List the site's keys, rotate the one that signs, or revoke one that signs no more.

    Machines follow a rotation by themselves, also when they were away. After a revocation, what the key has
    signed counts no more.

    Args:
        action: list, rotate or revoke.
        key: id of the key to revoke.
        reason: why, for the audit; rotate and revoke need it.
        login: which server, and by which account.
    """
    if action != "list" and reason is None:
        raise UsageError(f"`keys {action}` needs --reason, for the audit")
    if action == "revoke" and key is None:
        raise UsageError("`keys revoke` needs --key, as `keys list` names it")
    with login.open(USUAL_USER) as client:
        if action == "list":
            rows = client.call("GET", "/policy-keys")
        else:
            path = "/policy-keys/rotate" if action == "rotate" else f"/policy-keys/{key}/revoke"
            rows = client.call("POST", path, {"reason": reason})
    for row in rows:
        state = "revoked" if row["is_revoked"] else "signs" if row["is_signing"] else "trusted"
        since = row["since_utc"] or "first start"
        revoked = (
            f"  revoked {row['revoked_utc']} by {row['revoked_by']}" if row["is_revoked"] else ""
        )
        print(
            f"{row['key_id']}  {state:<7}  {row['approval_count']:>4} approvals  since {since} by "
            f"{row['made_by']}{revoked}  trusted by {', '.join(row['machine_ids']) or 'no machine'}  "
            f"public {row['public_key']}"
        )
    return 0


def compare(*, a: Path, b: Path) -> int:
    """Compare the accuracy of two versions, from results of `downrange evaluate --json`; needs no server.

    Example: downrange policy compare --a active.json --b candidate.json

    Args:
        a: result of the first version, for example the one in use.
        b: result of the second, from the same mode, plant and targets; better and worse are said of this one.
    """
    # Statistics and simulator take seconds to load; a rollback does not wait for them.
    from sim_twin.throws.accuracy_comparison import (
        compare_accuracy,
        comparison_table,
        read_accuracy,
    )

    first, second = read_accuracy(a), read_accuracy(b)
    print(comparison_table(first, second, compare_accuracy(first, second)))
    return 0


def shadow(
    folder: Annotated[Path, tyro.conf.Positional],
    logs: Annotated[list[Path], tyro.conf.Positional],
    /,
    *,
    policies: Path = Path("policies"),
    json: bool = False,
) -> int:
    """Show what a version would have done in throws that were recorded; nothing moves.

    It is shown what the network saw in each throw: how its velocities differ, and when it would have let go.
    And it throws in the machine's twin from the same start at the same target, beside the version that flew.

    Example: downrange policy shadow policies/m545-2d-v6 throws

    Args:
        folder: the version: network and card.
        logs: throw logs (MCAP) of one machine, or folders of them.
        policies: folder of policy versions, where those that flew are looked for.
        json: print the result as JSON.
    """
    from cli.service.policy_shadow import shadow_lines, shadow_of  # it needs the twin

    report = shadow_of(folder, logs, policies)
    lines = [report.model_dump_json(indent=2)] if json else shadow_lines(report)
    print("\n".join(lines))
    return 0


ACTIONS: dict[str, Callable[..., int]] = {
    "list": listed,
    "add": add,
    "check": check,
    "show": show,
    "approve": approve,
    "withdraw": withdraw,
    "retire": retire,
    "validate": validate,
    "deploy": deploy,
    "rollback": rollback,
    "rollout": rollout,
    "history": history,
    "keys": keys,
    "compare": compare,
    "shadow": shadow,
}


def _follow(client: ThrowClient, row: dict[str, Any], timeout_s: float) -> int:
    """Wait until the machine has answered; says what became of it."""
    path = f"/machines/{row['machine_id']}/deployments"
    end_s = time.monotonic() + timeout_s
    while row["outcome"] == PENDING and time.monotonic() < end_s:
        time.sleep(POLL_PERIOD_S)
        row = next(
            new
            for new in client.call("GET", path)
            if (new["mode"], new["deployment_count"]) == (row["mode"], row["deployment_count"])
        )
    if row["outcome"] == PENDING:
        print(
            f"{row['machine_id']} has not switched to {row['policy_id']} yet: it is off, or has a plan "
            "armed. It does so later."
        )
        return 3
    print(f"{row['machine_id']}: {row['policy_id']} {row['outcome']} {row['detail']}".rstrip())
    return 0 if row["outcome"] == "switched" else 3
