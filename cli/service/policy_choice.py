"""The version that a person names on the command line."""

from typing import Any

from machine.errors import UsageError


def choose_policy(
    policies: list[dict[str, Any]], name: str, *, has_gone: bool = False
) -> dict[str, Any]:
    """The one version with this id, or with a sha256 that begins so; if `has_gone`, its files may be gone.

    Raises:
        UsageError: none or several.
    """
    present = [policy for policy in policies if policy["is_present"] or has_gone]
    found = [p for p in present if p["policy_id"] == name] or [
        p for p in present if len(name) >= 6 and p["policy_sha256"].startswith(name)
    ]
    if len(found) != 1:
        known = ", ".join(policy["policy_id"] for policy in present)
        raise UsageError(f"--policy {name!r} names {len(found)} of the server's versions: {known}")
    return found[0]
