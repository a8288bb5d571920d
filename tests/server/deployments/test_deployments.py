"""Deployments through the interface: asked for by people, handed out to machines, ended by their events."""

import hashlib
import threading

import pytest
from sqlalchemy import delete

from cli.main import main
from machine.messages import EventKind
from server.store.models import Deployment, MachinePolicy
from tests.server.server_bench import PASSWORD, wait_for

REASON = {"reason": "retrained"}


@pytest.fixture(autouse=True)
def no_earlier_versions(running):
    """Other tests of the same server gave the machine versions to go back to."""
    with running.parts.database.write() as session:
        session.execute(delete(MachinePolicy).where(MachinePolicy.machine_id == "m001"))


@pytest.fixture
def eve(running):
    with running.client("eve") as client:
        yield client


@pytest.fixture
def sha256(running):
    return running.parts.policies.active("2d").card.policy_sha256


@pytest.fixture
def token(running):
    password = running.parts.registry.secret_path("m001").read_text().strip()
    return {"Authorization": f"Bearer {password}"}


def deploy(client, sha256, mode="2d", machine_id="m001"):
    body = REASON | {"policy_sha256": sha256}
    return client.post(f"/machines/{machine_id}/policies/{mode}/deploy", json=body)


def newest(client):
    return client.get("/machines/m001/deployments").json()[0]


def test_a_machine_is_told_fetches_by_parts_and_reports(running, machine, eve, sha256, token):
    row = deploy(eve, sha256).json()
    assert (row["outcome"], row["created_by"], row["reason"]) == ("pending", "eve", "retrained")
    with running.client() as nobody:
        wanted = nobody.get("/machines/m001/policies/wanted", headers=token).json()["policies"]
        (found,) = [w for w in wanted if w["mode"] == "2d"]
        assert (found["policy_sha256"], found["deployment_count"]) == (
            sha256,
            row["deployment_count"],
        )
        for file in found["files"]:
            path = f"/machines/m001/policy-files/{sha256}/{file['name']}"
            first = nobody.get(path, headers=token | {"Range": "bytes=0-99"})
            rest = nobody.get(path, headers=token | {"Range": "bytes=100-"})
            assert (first.status_code, rest.status_code) == (206, 206)
            content = first.content + rest.content
            assert len(content) == file["size_bytes"]
            assert hashlib.sha256(content).hexdigest() == file["sha256"]
            assert nobody.get(path).status_code == 401
            other = path.replace("m001", "m002")
            assert nobody.get(other, headers=token).status_code == 401
        gone = nobody.get(f"/machines/m001/policy-files/{'0' * 64}/card.json", headers=token)
        assert gone.status_code == 404
        odd = nobody.get(f"/machines/m001/policy-files/{sha256}/active.json", headers=token)
        assert odd.status_code == 422
    data = {"mode": "2d", "policy_sha256": sha256, "deployment_count": row["deployment_count"]}
    machine.event(EventKind.POLICY_SWITCHED, **data)
    wait_for(lambda: newest(eve)["outcome"] == "switched")
    # What comes later does not change how it ended.
    machine.event(EventKind.POLICY_REFUSED, **data, detail="late")
    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256="d" * 64)

    def aboard():
        policies = eve.get("/machines/m001/policies").json()["policies"]
        return next(p["policy_sha256"] for p in policies if p["mode"] == "2d")

    wait_for(lambda: aboard() == "d" * 64)
    assert newest(eve)["outcome"] == "switched"
    with running.client("root") as root:
        actions = [row["action"] for row in root.get("/audit").json()["rows"]]
    assert "policy.deploy" in actions


def test_back_to_the_version_before_and_what_is_replaced(running, machine, eve, sha256):
    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256=sha256)
    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256="e" * 64)

    def ask():
        reply = eve.post("/machines/m001/policies/2d/rollback", json=REASON)
        return reply if reply.status_code == 201 else None

    row = wait_for(ask).json()
    assert (row["policy_sha256"], row["is_rollback"]) == (sha256, True)
    # What the console says beforehand is what the server then does.
    aboard = eve.get("/machines/m001/policies").json()["policies"]
    assert [p["version_before"] for p in aboard if p["mode"] == "2d"] == [row["policy_id"]]
    again = deploy(eve, sha256).json()
    rows = eve.get("/machines/m001/deployments").json()
    assert [r["outcome"] for r in rows[:2]] == ["pending", "replaced"]
    detail = "the file is cut off"
    data = {"mode": "2d", "policy_sha256": sha256}
    count = again["deployment_count"]
    machine.event(EventKind.POLICY_REFUSED, **data, deployment_count=count, detail=detail)
    wait_for(lambda: (newest(eve)["outcome"], newest(eve)["detail"]) == ("refused", detail))


def test_rollbacks_at_the_machine_are_in_the_list_of_deployments(
    running, machine, eve, sha256, cli
):
    """One while it ran, one while it was off, which its next start tells of."""
    deploy(eve, sha256)

    def local():
        rows = eve.get("/machines/m001/deployments").json()
        return [r for r in rows if r["deployment_count"] is None]

    common = {"mode": "2d", "deployment_count": None}
    machine.event(EventKind.POLICY_SWITCHED, **common, policy_sha256="1" * 64, slot="1" * 64)
    (row,) = wait_for(local)
    assert (row["created_by"], row["policy_id"]) == ("m001", "1" * 12)
    assert (row["is_rollback"], row["reason"]) == (True, "rolled back at the machine")
    assert row["outcome"] == "switched"
    machine.event(EventKind.POLICY_SWITCHED, **common, policy_sha256="2" * 64)
    machine.event(
        EventKind.BOOTED, policy_sha256={"2d": "3" * 64}, rolled_back_from={"2d": "2" * 64}
    )
    wait_for(lambda: [r["policy_id"] for r in local()] == ["3" * 12, "1" * 12])
    # A start with another version for any other reason is none.
    machine.event(
        EventKind.BOOTED, policy_sha256={"2d": "4" * 64}, rolled_back_from={"2d": "2" * 64}
    )

    def aboard():
        policies = eve.get("/machines/m001/policies").json()["policies"]
        return next(p["policy_sha256"] for p in policies if p["mode"] == "2d")

    wait_for(lambda: aboard() == "4" * 64)
    assert len(local()) == 2
    code, text = cli("history", "--machine", "m001")
    assert (code, "switched  m001: rolled back at the machine" in text) == (0, True)


def test_a_second_rollback_does_not_bring_back_what_the_first_took_away(
    running, machine, eve, sha256
):
    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256=sha256)
    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256="e" * 64)

    def ask():
        reply = eve.post("/machines/m001/policies/2d/rollback", json=REASON)
        return reply if reply.status_code == 201 else None

    count = wait_for(ask).json()["deployment_count"]
    data = {"mode": "2d", "policy_sha256": sha256, "deployment_count": count}
    machine.event(EventKind.POLICY_SWITCHED, **data)
    wait_for(lambda: newest(eve)["outcome"] == "switched")
    second = eve.post("/machines/m001/policies/2d/rollback", json=REASON)
    error = second.json()["error"]
    assert (second.status_code, error["code"]) == (409, "no_version_before")
    assert error["message"] == (
        "m001 has no version before swing-2d in 2d: eeeeeeeeeeee was rolled back. Deploy the version that "
        "it is to have."
    )


def test_a_start_with_the_wanted_version_ends_a_deployment(running, machine, eve, sha256):
    count = deploy(eve, sha256).json()["deployment_count"]
    machine.event(EventKind.BOOTED, policy_sha256={"2d": "f" * 64})
    machine.event(EventKind.BOOTED, policy_sha256={"2d": sha256})
    wait_for(lambda: newest(eve)["outcome"] == "switched")
    with running.parts.database.read() as session:
        assert session.get(Deployment, ("m001", "2d", count)).ended_utc is not None


def test_what_cannot_be_deployed_is_refused_with_the_reason(running, eve, sha256):
    assert deploy(eve, "0" * 64).json()["error"]["code"] == "no_policy"
    wrong = deploy(eve, sha256, mode="3d").json()["error"]
    assert wrong["code"] == "wrong_mode"
    assert "is for mode 2d, not 3d" in wrong["message"]
    assert deploy(eve, sha256, machine_id="m999").json()["error"]["code"] == "no_machine"
    assert deploy(eve, "short").status_code == 422
    nothing = eve.post("/machines/m002/policies/3d/rollback", json=REASON).json()["error"]
    assert nothing["code"] == "no_version_before"
    with running.client("sue") as sue:
        assert deploy(sue, sha256).status_code == 403


@pytest.fixture
def cli(running, tmp_path, capsys):
    """Run `downrange policy ...` against the server; exit code and what it prints."""
    file = tmp_path / "eve.txt"
    file.write_text(PASSWORD, encoding="utf-8")

    def call(*arguments):
        common = ("--server", running.url, "--user", "eve", "--password-file", str(file))
        code = main(["policy", *arguments, *common])
        return code, "".join(capsys.readouterr())

    return call


def test_the_command_line_deploys_waits_and_tells(running, machine, eve, sha256, cli):
    ask = ("--policy", sha256[:12], "--machine", "m001", "--reason", "retrained")
    code, text = cli("deploy", *ask, "--timeout", "0.3")
    assert (code, "has not switched to swing-2d yet" in text) == (3, True)
    code, text = cli("deploy", "--policy", "swing-9d", *ask[2:])
    assert (code, "swing-2d" in text) == (1, True)

    def answer():
        wait_for(lambda: newest(eve)["outcome"] == "pending" and newest(eve)["is_rollback"])
        count = newest(eve)["deployment_count"]
        data = {"mode": "2d", "policy_sha256": sha256, "deployment_count": count}
        machine.event(EventKind.POLICY_SWITCHED, **data)

    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256=sha256)
    machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256="e" * 64)

    def aboard():
        policies = eve.get("/machines/m001/policies").json()["policies"]
        return next((p["policy_sha256"] for p in policies if p["mode"] == "2d"), None)

    wait_for(lambda: aboard() == "e" * 64)
    helper = threading.Thread(target=answer, daemon=True)
    helper.start()
    code, text = cli("rollback", "--machine", "m001", "--mode", "2d", "--reason", "it misses")
    helper.join()
    assert (code, "swing-2d switched" in text) == (0, True)
    code, text = cli("history", "--machine", "m001")
    assert code == 0
    assert "back to swing-2d  switched  eve: it misses" in text
    code, text = cli("history", "--machine", "m001", "--at", "2001-01-01T00:00:00+00:00")
    assert (code, "had not been started" in text) == (0, True)
    code, text = cli("list")
    assert (code, f"swing-2d                 2d  {sha256[:12]}" in text) == (0, True)
