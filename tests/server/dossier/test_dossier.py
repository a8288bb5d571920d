"""Dossiers: whole ones are found whole, and any altered byte is found, wherever it is."""

import hashlib
import io
import json
import zipfile
from datetime import timedelta

import pytest

from cli.main import main
from cli.service.throw import run as throw_once
from cli.service.throw_client import ServerLogin
from machine.errors import UsageError
from machine.policy_approval import new_private_key, public_key, sign
from server.accounts.audit_seal import FIRST_SHA256, SEALED_FIELDS, seal_of
from server.clock import utc_now
from server.dossier import dossier_service
from server.dossier.dossier_check import check_open_dossier, public_keys
from server.dossier.signed_archive import (
    SIGNED_PREFIX,
    ArchiveBody,
    DossierError,
    DossierManifest,
    DossierSignature,
    canonical_json,
    model_json,
)
from server.errors import ConflictError, NotFoundError, TooManyRequestsError
from server.schemas.console import Role
from server.schemas.history import Outcome
from server.store.models import Machine
from server.throws.throw_history import ThrowFilter
from tests.cases import each
from tests.server.fleet.test_machine_summaries import add_throws
from tests.server.server_bench import PASSWORD, wait_for
from tests.server.store.test_database import machine

KEY = new_private_key()


def audit_line(altered=None, **values):
    row = dict.fromkeys(SEALED_FIELDS) | {"sequence_count": 1, "detail_json": "{}"} | values
    seal = seal_of(FIRST_SHA256, list(row.values()))
    seals = {"previous_sha256": FIRST_SHA256, "row_sha256": seal}
    return canonical_json({**row, **seals, **(altered or {})})


def archive(members: dict[str, bytes], key: bytes = KEY) -> bytes:
    body = ArchiveBody(io.BytesIO())
    for name, content in members.items():
        body.add_bytes(name, content)
    manifest = model_json(
        DossierManifest(
            site="yard",
            machine_id="m001",
            throw_id="t",
            since_utc=None,
            until_utc=None,
            throw_count=1,
            created_utc="2026-01-01T00:00:00+00:00",
            created_by="sue",
            software="1",
            audit_sequence_count=1,
            audit_sha256="0" * 64,
            members=tuple(body.members),
        )
    )
    public = public_key(key)
    signature = sign(key, SIGNED_PREFIX + manifest)
    signed = DossierSignature(
        key_id=public.key_id, public_key=public.public_key, signature=signature
    )
    before, after = body.around(manifest, model_json(signed))
    assert isinstance(body.scratch, io.BytesIO)
    return before + body.scratch.getvalue() + after


SMALL = archive({"audit.jsonl": audit_line(), "throws/t/log.mcap": bytes(range(64)), "none": b""})


def problems(content: bytes, trusted: frozenset[str] = frozenset()) -> list[str]:
    return check_open_dossier(io.BytesIO(content), trusted).problems


def test_every_flipped_byte_is_found():
    assert problems(SMALL) == []
    for place in range(len(SMALL)):
        for mask in (0x01, 0x20, 0xFF):
            altered = bytearray(SMALL)
            altered[place] ^= mask
            assert problems(bytes(altered)), (place, mask)


def test_what_was_altered_is_named():
    log = SMALL.index(bytes(range(64)))
    altered = SMALL[:log] + b"\x09" + SMALL[log + 1 :]
    assert problems(altered) == ["throws/t/log.mcap was altered"]
    header = SMALL.rindex(b"PK\x03\x04", 0, log)
    altered = SMALL[: header + 10] + b"\x01" + SMALL[header + 11 :]
    assert problems(altered) == ["the header of throws/t/log.mcap was altered"]
    assert problems(SMALL + b"\x00") == ["there are bytes after the end of the dossier"]
    for length in range(0, len(SMALL), 7):
        assert problems(SMALL[:length]), length


DEEP = b"[" * 100_000
FIRED = {"action": "fire", "phase": "fact", "throw_id": "t"}


@each(
    "members",
    [
        {"audit.jsonl": DEEP},
        {"audit.jsonl": b"[]\n"},
        {"audit.jsonl": b"1\n"},
        {"audit.jsonl": b"\xff"},
        {"audit.jsonl": b'{"sequence_count":' + b"9" * 9000 + b"}"},
        {"audit.jsonl": audit_line(**FIRED, detail_json="[]")},
        {"audit.jsonl": audit_line(**FIRED, detail_json=DEEP.decode())},
        {"audit.jsonl": audit_line(**FIRED | {"throw_id": []}, detail_json='{"plan_hash":"x"}')},
        {"throws/t/throw.json": DEEP, "throws/t/plan.json": b"{}"},
        {"throws/t/throw.json": b"[]", "throws/t/plan.json": DEEP},
        {"site_keys.json": DEEP},
        {"site_keys.json": b"[]"},
    ],
)
def test_members_that_are_signed_but_of_another_form_are_a_problem_and_no_crash(members):
    (found,) = problems(archive(members))
    assert found.startswith("signed as it is, but its members cannot be read")


def test_what_a_file_says_can_neither_add_a_line_nor_steer_a_terminal(tmp_path, capsys):
    path = tmp_path / "dossier.zip"
    hostile = "1\x1b[2J\nwhole: throw t of m001, site yard"
    path.write_bytes(archive({"audit.jsonl": audit_line({"sequence_count": hostile})}))
    assert main(["dossier", "verify", str(path)]) == 3
    shown = capsys.readouterr().out
    assert "\x1b" not in shown and "\nwhole" not in shown
    assert r"audit row 1\x1b[2J\nwhole: throw t" in shown


def test_other_tools_read_it_but_do_not_write_the_same_file():
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(SMALL)) as source, zipfile.ZipFile(packed, "w") as copy:
        assert source.testzip() is None
        for name in source.namelist():
            copy.writestr(name, source.read(name))
    assert problems(packed.getvalue())


def test_a_file_signed_by_somebody_else_needs_the_key_from_outside():
    ours = frozenset({public_key(KEY).public_key})
    assert problems(SMALL, ours) == []
    forged = archive({"audit.jsonl": audit_line()}, new_private_key())
    assert problems(forged) == []
    assert "not the given one" in problems(forged, ours)[0]
    assert public_keys(public_key(KEY).public_key) == ours
    with pytest.raises(UsageError, match="no public key"):
        public_keys(public_key(KEY).key_id)


def test_an_audit_row_that_was_changed_before_the_export_is_found():
    changed = archive({"audit.jsonl": audit_line({"actor": "bob"})})
    assert problems(changed) == ["audit row 1 was changed before the dossier was made"]


def test_what_the_audit_holds_the_hash_of_has_to_be_that():
    throw = canonical_json({"plan_hash": "a" * 64})
    for action, name, hash_name in (
        ("fire", "throw.json", "plan_hash"),
        ("throw.log", "log.mcap", "log_sha256"),
    ):
        right = "a" * 64 if name == "throw.json" else hashlib.sha256(throw).hexdigest()
        for recorded in (right, "b" * 64):
            row = {"action": action, "phase": "intent", "throw_id": "t"}
            detail = json.dumps({hash_name: recorded})
            line = audit_line(detail_json=detail, **row)
            found = problems(archive({"audit.jsonl": line, f"throws/t/{name}": throw}))
            assert len(found) == (recorded != right), found
            assert all(name in problem for problem in found)


def test_too_large_a_dossier_is_refused_while_it_is_made():
    with pytest.raises(DossierError, match="shorter period"):
        ArchiveBody(io.BytesIO(), max_bytes=10).add_bytes("a", bytes(11))


@pytest.fixture
def login(tmp_path):
    path = tmp_path / "password"
    path.write_text(f"{PASSWORD}\n")
    return path


def test_a_throw_is_exported_and_verified_from_the_command_line(
    running, machine, login, tmp_path, capsys
):
    begun = utc_now()
    assert throw_once(login=ServerLogin(running.url, "bob", login), target="6.03") == 0
    throw_id = machine.executed[-1]
    wait_for(lambda: running.parts.history.page(_all(), None, 1).rows[0].phase == "ended")
    with running.client("sue") as sue:
        sue.post(
            f"/throws/{throw_id}/impacts", json={"downrange_error_m": 0.2, "crossrange_error_m": 0}
        )
        period = {
            "since": begun.isoformat(),
            "until": (utc_now() + timedelta(minutes=1)).isoformat(),
        }
        extent = sue.get("/machines/m001/dossier/extent", params=period).json()
        assert (extent["throw_count"], extent["problem"]) == (1, None)
        rows = sue.get("/audit", params={"action": "dossier.export"}).json()["rows"]
        assert rows == []
    who = ["--server", running.url, "--user", "sue", "--password-file", str(login)]
    trust = running.parts.approvals.trust()
    # Other tests may have changed the site's key.
    [key] = [one.public_key for one in trust.keys if one.key_id == trust.signed_by]
    one, many = tmp_path / "one.zip", tmp_path / "many.zip"
    span = ["--machine", "m001", "--from", period["since"], "--to", period["until"]]
    assert main(["dossier", "export", throw_id, "-o", str(one), *who]) == 0
    assert main(["dossier", "export", *span, "-o", str(many), *who]) == 0
    for file in (one, many):
        capsys.readouterr()
        assert main(["dossier", "verify", str(file), "--key", key]) == 0, capsys.readouterr().out
        out = capsys.readouterr().out
        assert "whole" in out and "1 hashes of plans" in out and "1 policy versions" in out
    with zipfile.ZipFile(one) as found:
        names = {name.rpartition("/")[2] for name in found.namelist()}
        lines = found.read("audit.jsonl").splitlines()
        page = found.read("index.html").decode()
        impacts = json.loads(found.read(f"throws/{throw_id}/impacts.json"))
    assert names >= {"throw.json", "plan.json", "preview.json", "preview_motion.json"}
    assert names >= {"policy.onnx", "card.json", "history.json", "site_keys.json"}
    actions = {(row["actor"], row["action"]) for row in map(json.loads, lines)}
    assert {("bob", "login"), ("bob", "lease.acquire"), ("bob", "arm"), ("bob", "fire")} <= actions
    assert ("sue", "impact.mark") in actions
    assert [impact["source"] for impact in impacts][-1] == "manual"
    assert (
        throw_id in page and "0.20 m long" in page and "http" not in page.replace("http-equiv", "")
    )
    assert "bob" in page
    content = bytearray(one.read_bytes())
    content[len(content) // 2] ^= 1
    one.write_bytes(content)
    assert main(["dossier", "verify", str(one)]) == 3
    assert "FAILED" in capsys.readouterr().out
    with running.client("sue") as sue:
        rows = sue.get("/audit", params={"action": "dossier.export"}).json()["rows"]
    assert [row["actor"] for row in rows] == ["sue", "sue"]


def _all():
    return ThrowFilter()


def set_machine(parts, machine_id, **values):
    with parts.database.write() as database:
        row = database.get_one(Machine, machine_id)
        for name, value in values.items():
            setattr(row, name, value)


def test_what_a_period_may_hold(assembled, monkeypatch, tmp_path):
    parts, sue = assembled.parts, assembled.session("sue", Role.SUPERVISOR)
    parts.uploads.start()
    parts.approvals.start()
    begin, end = utc_now() - timedelta(hours=1), utc_now() + timedelta(hours=1)
    spare = "m003"
    with parts.database.write() as database:
        database.add(machine(spare))
    with pytest.raises(NotFoundError, match="no machine 'm001'; none is known yet"):
        parts.dossiers.of_period("m001", begin, end, sue)
    for name in ("m001", "m002"):
        set_machine(parts, name, is_listed=True)
    with pytest.raises(NotFoundError, match="no ended throw"):
        parts.dossiers.of_period("m001", begin, end, sue)
    for name in ("m099", spare):
        with pytest.raises(NotFoundError, match=f"no machine '{name}'; known: m001, m002"):
            parts.dossiers.of_period(name, begin, end, sue)
    set_machine(parts, spare, retired_utc=begin)
    with pytest.raises(NotFoundError, match=f"{spare} has no ended throw"):
        parts.dossiers.of_period(spare, begin, end, sue)
    add_throws(parts, 3, 0.1)
    add_throws(parts, 1, 0.1, machine_id="m002")
    add_throws(parts, 1, 0.1, phase="throwing")
    newest = parts.history.page(ThrowFilter(machine_id="m001", outcome=Outcome.LANDED), None, 9)
    throw_id = newest.rows[-1].throw_id
    (tmp_path / "upload").write_bytes(b"a log")
    parts.logs.keep(tmp_path / "upload", "m001", throw_id, hashlib.sha256(b"a log").hexdigest(), 5)
    assert parts.dossiers.extent("m001", begin, end).log_bytes == 5
    made = parts.dossiers.of_period("m001", begin, end, sue)
    content = b"".join(made.chunks())
    verdict = check_open_dossier(io.BytesIO(content))
    assert verdict.problems == []
    assert verdict.manifest is not None and verdict.manifest.throw_count == 3
    assert len(content) == made.size_bytes
    with zipfile.ZipFile(io.BytesIO(content)) as found:
        assert found.read(f"throws/{throw_id}/log.mcap") == b"a log"
    with pytest.raises(ConflictError, match="at most 366 days"):
        parts.dossiers.of_period("m001", begin - timedelta(days=400), end, sue)
    with parts.dossiers._turn, pytest.raises(TooManyRequestsError):
        parts.dossiers.of_period("m001", begin, end, sue)
    monkeypatch.setattr(dossier_service, "MAX_THROW_COUNT", 2)
    with pytest.raises(ConflictError, match="3 throws; a dossier holds at most 2"):
        parts.dossiers.of_period("m001", begin, end, sue)
    with pytest.raises(ConflictError, match="not ended"):
        parts.dossiers.of_throw(_running_throw(parts), sue)


def _running_throw(parts):
    page = parts.history.page(_all(), None, 50)
    return next(row.throw_id for row in page.rows if row.phase == "throwing")
