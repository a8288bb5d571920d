"""Validations in the server: queue, process, gates, cancel, restart, comparison, rights."""

from contextlib import contextmanager
from functools import partial

import pytest
from sqlalchemy import update

from cli.main import main
from evaluation.validation.gates import DEFAULT_GATES
from server.store.models import Throw
from server.store.validation_tables import PolicyValidation
from server.validation.validation_worker import CampaignProcesses, ValidationProcess
from tests.server.gap_bench import add_throws, forget_throws
from tests.server.server_bench import PASSWORD, add_people, make_settings, running_server
from tests.server.validation import validation_fakes
from tests.server.validation.validation_fakes import InThread
from tests.waiting import wait_for

LONG_S = 240.0
SMALL = {"protocol": "short", "throws_per_target": 2, "unseen_unit_count": 0}


@pytest.fixture(scope="module")
def eve(running):
    with running.client("eve") as client:
        yield client


@pytest.fixture(scope="module")
def shas(running):
    """Hash of each version by name."""
    return {p.card.policy_id: p.card.policy_sha256 for p in running.parts.policies.present()}


@contextmanager
def validating(parts, how, process=InThread):
    """The server's validations run so; what is open is cancelled at the end."""
    service = parts.validations
    before = service._process
    service._process = process(how)
    try:
        yield
    finally:
        for run in service.queue.open_jobs():
            run.cancelled.set()
        wait_for(lambda: not service.queue.open_jobs())
        service._process = before


def path(sha256):
    return f"/policies/{sha256}/validation"


def ended(client, sha256):
    wait_for(lambda: client.get(path(sha256)).json()["ended_utc"], LONG_S)
    return client.get(path(sha256)).json()


@pytest.fixture(scope="module")
def validated(running, eve, shas):
    """The version that stands still, validated beside the active one, which swings."""
    sha256 = shas["waits-2d"]
    with validating(running.parts, validation_fakes.in_twin):
        assert eve.get(path(sha256)).json() is None
        reply = eve.post(path(sha256), json=SMALL)
        assert reply.status_code == 202, reply.text
        return ended(eve, sha256)


def test_a_version_is_thrown_beside_the_active_one_and_checked(running, eve, shas, validated):
    assert (validated["state"], validated["is_passed"]) == ("done", False)
    assert validated["active_sha256"] == shas["swing-2d"]
    result = validated["result"]
    assert result["active"]["policy_id"] == "swing-2d"
    checks = {check["gate"]: check for check in result["checks"]}
    assert checks["landed"]["value"] == 0.0
    assert not checks["landed"]["is_passed"]
    assert checks["repeatable"]["is_passed"]
    (unit,) = result["candidate"]["units"]
    log = unit["failures"][0]["log"]
    logs = f"/policy-validations/{validated['validation_id']}/logs"
    assert eve.get(f"{logs}/{log}").content[:5] == b"\x89MCAP"
    assert eve.get(f"{logs}/other.mcap").status_code == 404
    assert eve.get(f"{logs}/..%2f..%2fdownrange.db").status_code == 404
    life = eve.get(f"/policies/{shas['waits-2d']}/history").json()
    steps = [(step["from_state"], step["to_state"]) for step in life]
    # The server's first start approves what is there: it stays approved, and takes no step.
    assert steps[-1][1] == "approved"
    with running.client("root") as root:
        actions = {row["action"] for row in root.get("/audit").json()["rows"]}
    assert {"policy.validate", "policy.validate.not_passed"} <= actions


def test_the_command_line_follows_and_answers_by_the_gates(running, capsys, tmp_path):
    password = tmp_path / "eve.txt"
    password.write_text(PASSWORD, encoding="utf-8")
    arguments = ["policy", "validate", "--policy", "waits-3d", "--throws", "2", "--units", "0"]
    login = ["--server", running.url, "--user", "eve", "--password-file", str(password)]
    with validating(running.parts, validation_fakes.losing):
        assert main([*arguments, *login]) == 3
    shown = capsys.readouterr().out
    assert "Throws that land" in shown
    assert "waits-3d: NOT PASSED" in shown
    assert shown.count("no_release") == 4


def test_one_at_a_time_cancelled_failed_and_died(running, eve, shas):
    sha256 = shas["waits-3d"]
    in_process = partial(ValidationProcess, CampaignProcesses())
    with validating(running.parts, validation_fakes.patient, in_process):
        assert eve.post(path(sha256), json=SMALL).status_code == 202
        again = eve.post(path(sha256), json=SMALL)
        assert (again.status_code, again.json()["error"]["code"]) == (409, "validation_open")
        wait_for(lambda: "part" in eve.get(path(sha256)).json()["step"], LONG_S)
        assert eve.delete(path(sha256)).status_code == 200
        assert ended(eve, sha256)["state"] == "cancelled"
        assert eve.delete(path(sha256)).status_code == 409
    for how, process, words in (
        (validation_fakes.refusing, InThread, "cannot be calibrated"),
        (validation_fakes.dying, in_process, "exit code 7"),
    ):
        with validating(running.parts, how, process):
            eve.post(path(sha256), json=SMALL)
            found = ended(eve, sha256)
            assert found["state"] == "failed"
            assert words in found["detail"]
    unknown = eve.post(path("0" * 64), json=SMALL)
    assert (unknown.status_code, unknown.json()["error"]["code"]) == (404, "no_policy")


def test_a_restart_goes_on_with_the_parts_that_are_missing(tmp_path, swing_policies, monkeypatch):
    def run_so(how):
        monkeypatch.setattr("server.composition.ValidationProcess", lambda _: InThread(how))

    settings = make_settings(tmp_path, swing_policies)
    run_so(validation_fakes.patient)
    with running_server(settings) as running:
        add_people(running.parts)
        present = running.parts.policies.present()
        ids = {p.card.policy_id: p.card.policy_sha256 for p in present}
        sha256 = ids["waits-2d"]
        with running.client("eve") as eve:
            assert eve.post(path(sha256), json=SMALL).status_code == 202
            started = validation_fakes.PART
            wait_for(lambda: eve.get(path(sha256)).json()["step"].startswith(started), LONG_S)
            before = eve.get(path(sha256)).json()
        store = running.parts.validations.store
        kept = store.parts(before["validation_id"])
        assert list(kept) == [f"{sha256[:16]}/0"]
    run_so(validation_fakes.only_missing)
    with running_server(settings) as running, running.client("eve") as eve:
        found = ended(eve, sha256)
    assert found["validation_id"] == before["validation_id"]
    assert (found["state"], found["detail"]) == ("done", "")
    (unit,) = found["result"]["candidate"]["units"]
    assert unit == kept[f"{sha256[:16]}/0"].model_dump(mode="json")


def test_a_version_that_is_not_approved_moves_on_only_with_all_gates(running, eve, shas):
    sha256 = shas["waits-3d"]
    assert eve.post(f"/policies/{sha256}/withdraw", json={"reason": "a test"}).status_code == 204

    def steps():
        return [step["to_state"] for step in eve.get(f"/policies/{sha256}/history").json()]

    before = len(steps())
    with validating(running.parts, validation_fakes.losing):
        eve.post(path(sha256), json=SMALL)
        assert ended(eve, sha256)["is_passed"] is False
    assert steps()[before:] == ["validating", "uploaded"]
    with validating(running.parts, validation_fakes.passing):
        eve.post(path(sha256), json=SMALL)
        assert ended(eve, sha256)["is_passed"] is True
    assert steps()[before:] == ["validating", "uploaded", "validating", "validated"]
    newest = eve.get(f"/policies/{sha256}/history").json()[-1]
    assert newest["reason"].startswith("passed all")
    assert newest["evidence"]["gates"]["landed"]["limit"] == 0.98
    assert is_validated(eve, sha256)
    assert approve(eve, sha256).status_code == 201
    assert eve.get(f"/policies/{sha256}/history").json()[-1]["evidence"]["gates"]["landed"]


def is_validated(client, sha256):
    return client.get(f"/policies/{sha256}/approval-basis").json()["is_validated"]


def approve(client, sha256, **more):
    return client.post(f"/policies/{sha256}/approve", json={"reason": "as before", **more})


def test_an_approval_needs_a_validation_of_these_files_by_the_gates_in_force(running, eve, shas):
    sha256, database = shas["waits-3d"], running.parts.database
    assert is_validated(eve, sha256)
    strict = DEFAULT_GATES["3d"].model_dump(mode="json") | {"sd_m": 0.001}
    eve.post("/policy-gates/3d", json={"gates": strict, "reason": "a test"})
    assert eve.post(f"/policies/{sha256}/withdraw", json={"reason": "a test"}).status_code == 204
    refused = approve(eve, sha256).json()["error"]
    assert refused["code"] == "not_validated"
    assert "2 of 9 gates in its newest validation: Spread along" in refused["message"]
    usual = DEFAULT_GATES["3d"].model_dump(mode="json")
    eve.post("/policy-gates/3d", json={"gates": usual, "reason": "a test"})
    assert is_validated(eve, sha256)
    with database.write() as session:
        session.execute(update(PolicyValidation).values(card_sha256="0" * 64))
    assert "with another card" in approve(eve, sha256).json()["error"]["message"]
    assert approve(eve, sha256, is_without_validation=True).status_code == 201
    newest = eve.get(f"/policies/{sha256}/history").json()[-1]["evidence"]
    assert newest["is_without_validation"] is True
    with running.client("root") as root:
        rows = root.get("/audit").json()["rows"]
    (entry,) = [row for row in rows if row["action"] == "policy.approve.without_validation"][:1]
    assert entry["detail"]["reason"] == "as before"


def test_gates_are_set_by_an_engineer_and_kept(running, eve):
    (planar, _) = eve.get("/policy-gates").json()
    assert planar["gates"] == planar["defaults"] == DEFAULT_GATES["2d"].model_dump(mode="json")
    assert planar["version_count"] == 0
    body = {"gates": planar["gates"] | {"sd_m": 0.2}, "reason": "a softer yard"}
    reply = eve.post("/policy-gates/2d", json=body)
    assert reply.status_code == 201, reply.text
    (planar, spatial) = eve.get("/policy-gates").json()
    assert (planar["gates"]["sd_m"], planar["version_count"]) == (0.2, 1)
    assert (planar["set_by"], planar["reason"]) == ("eve", "a softer yard")
    assert spatial["gates"] == spatial["defaults"]
    with running.client("ada") as ada:
        assert ada.post("/policy-gates/2d", json=body).status_code == 403
    wrong = eve.post("/policy-gates/2d", json=body | {"gates": planar["gates"] | {"sd_m": 0.0}})
    assert wrong.status_code == 422
    eve.post("/policy-gates/2d", json={"gates": planar["defaults"], "reason": "as before"})


def test_two_versions_are_compared_by_validations_and_by_real_throws(running, eve, shas, validated):
    a, b = shas["swing-2d"], shas["waits-2d"]
    forget_throws(running.parts)
    first = eve.get("/policies/compare", params={"a": a, "b": b}).json()
    by = {one["source"]: one for one in first["comparisons"]}
    assert (first["a_policy_id"], first["b_policy_id"]) == ("swing-2d", "waits-2d")
    landed = [d for d in by["validation"]["differences"] if d["quantity"] == "landed"]
    assert [d["b"] for d in landed] == [0.0, 0.0]
    assert {d["verdict"] for d in landed} <= {"worse", "cannot tell"}
    assert by["history"]["differences"] == []
    assert "No machine" in by["history"]["basis"]
    # Twelve throws of one machine with each: b lands 0.3 m farther than a.
    for sha256, mean_m in ((a, 0.0), (b, 0.3)):
        ids = add_throws(running.parts, 12, has_log=False)
        with running.parts.database.write() as database:
            for number, throw_id in enumerate(ids):
                row = database.get(Throw, throw_id)
                assert row is not None
                row.policy_sha256, row.mode = sha256, "2d"
                row.measured_downrange_error_m = mean_m + 0.01 * (number % 3 - 1)
                row.measured_crossrange_error_m = 0.01 * (number % 4)
    second = eve.get("/policies/compare", params={"a": a, "b": b}).json()
    (history,) = [one for one in second["comparisons"] if one["source"] == "history"]
    down = next(d for d in history["differences"] if d["quantity"] == "mean down")
    assert (down["verdict"], down["a_throw_count"], down["b_throw_count"]) == ("worse", 12, 12)
    assert down["difference"][0] < 0.3 < down["difference"][1]
    assert {group["group"] for group in history["stats"]["groups"]} == {a, b}
    same = eve.get("/policies/compare", params={"a": a, "b": a})
    other = eve.get("/policies/compare", params={"a": a, "b": shas["swing-3d"]})
    assert (same.status_code, other.status_code) == (409, 409)
    forget_throws(running.parts)
