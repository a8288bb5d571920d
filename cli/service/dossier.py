"""`downrange dossier`: throws with all that belongs to them, as one signed file; and its verification."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import tyro

from cli.service.throw_client import USUAL_LOGIN, Login
from machine.errors import UsageError
from server.dossier.dossier_check import DossierVerdict, check_dossier, public_keys

ALTERED_CODE = 3


def export(
    throw: Annotated[str | None, tyro.conf.Positional] = None,
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(name="output", aliases=["-o"])],
    machine: str | None = None,
    since: Annotated[str | None, tyro.conf.arg(name="from")] = None,
    until: Annotated[str | None, tyro.conf.arg(name="to")] = None,
    login: Login = USUAL_LOGIN,
) -> int:
    """Export one throw, or a machine's throws of a period, through a running server; a supervisor may.

    Example: downrange dossier export --machine m001 --from 2026-05-01 --to 2026-06-01 -o may.zip

    Args:
        throw: id of the throw.
        output: file to write.
        machine: in place of a throw: the machine.
        since: beginning of the period, ISO 8601; UTC without a zone.
        until: its end, not included.
        login: which server, and by which account.
    """
    if (throw is None) == (machine is None):
        raise UsageError("name either a throw, or --machine with --from and --to")
    query: dict[str, str] = {}
    if machine is None:
        path = f"/throws/{quote(throw or '', safe='')}/dossier"
    else:
        path = f"/machines/{quote(machine, safe='')}/dossier"
        query = {"since": _moment("--from", since), "until": _moment("--to", until)}
    with login.open("admin") as client:
        size_bytes = client.download(path, query, output)
    print(f"{output}: {size_bytes / 1e6:.1f} MB; check it by `downrange dossier verify {output}`")
    return 0


def verify(file: Annotated[Path, tyro.conf.Positional], /, *, key: str | None = None) -> int:
    """Check every byte of a dossier, its signature, plans, audit rows and approvals; needs no server.

    Exit 3 when anything was altered, or the key is not the given one.

    Args:
        file: the dossier.
        key: the site's public key, as `downrange policy keys list` prints it, or a file with it; without one
            nothing shows that it was the site that signed.
    """
    verdict = check_dossier(file, frozenset() if key is None else public_keys(key))
    for line in in_words(verdict):
        print(line)
    return 0 if verdict.is_whole else ALTERED_CODE


def in_words(verdict: DossierVerdict) -> list[str]:
    """What was found, as lines; what the file says cannot begin another line or steer the terminal."""
    return [
        "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in line)
        for line in _words(verdict)
    ]


def _words(verdict: DossierVerdict) -> list[str]:
    if not verdict.is_whole:
        return [f"FAILED: {problem}" for problem in verdict.problems]
    manifest, key = verdict.manifest, verdict.key
    assert manifest is not None and key is not None, "a whole dossier has both"
    about = f"throw {manifest.throw_id}" if manifest.throw_id else f"{manifest.throw_count} throws"
    origin = (
        "the given key"
        if verdict.is_key_given
        else f"public key {key.public_key}; only --key shows whether that is the site's"
    )
    return [
        f"whole: {about} of {manifest.machine_id}, site {manifest.site}, made {manifest.created_utc} "
        f"by {manifest.created_by}",
        f"signed by key {key.key_id}: {origin}",
        f"also right: {verdict.checked_plan_count} hashes of plans, {verdict.checked_audit_count} seals "
        f"of audit rows, {verdict.checked_policy_count} policy versions",
        *(f"note: {note}" for note in verdict.notes),
    ]


def _moment(option: str, text: str | None) -> str:
    try:
        moment = datetime.fromisoformat(text or "")
    except ValueError as error:
        raise UsageError(
            f"{option} {text or ''}: a time as in 2026-05-01 or 2026-05-01T08:00"
        ) from error
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).isoformat()


ACTIONS = {"export": export, "verify": verify}
