import json
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import select

from cli.main import main
from machine.conventions import Mode
from machine.errors import PolicyError
from server.deployments import approval_basis, site_approvals
from server.deployments.site_approvals import ApprovalError, SiteApprovals
from server.errors import ConflictError, NotFoundError
from server.plans.policy_life import change_state, history
from server.schemas.console import Role
from server.schemas.deployments import DeployRequest
from server.schemas.policies import PolicyState
from server.store.models import Audit
from tests.runtime.quick_policy import write_policy
from tests.server.server_bench import PASSWORD

WHY = "for a test"


@pytest.fixture
def approvals(assembled):
    found = assembled.parts.approvals
    found.start()
    return found


def fresh(assembled, data_dir):
    parts = assembled.parts
    return SiteApprovals(parts.database, parts.audit, parts.policies, "yard", data_dir)


def test_the_first_start_makes_a_key_and_approves_what_is_there(assembled, approvals):
    parts = assembled.parts
    folder = parts.settings.data_dir / "policy-approvals"
    assert (folder / "site.key").stat().st_mode & 0o777 == 0o600
    present = parts.policies.present()
    assert len(present) >= 2
    assert all(approvals.is_approved(policy) for policy in present)
    by = {approval.approved_by for approval in approvals.trust().approvals}
    assert by == {"the site's key at first start"}
    again = fresh(assembled, parts.settings.data_dir)
    again.start()
    assert again.trust() == approvals.trust()


def test_an_approval_is_withdrawn_and_given_again_by_a_person(assembled, approvals):
    policy = assembled.parts.policies.active("2d")
    sha256, eve = policy.card.policy_sha256, assembled.session("eve", Role.ENGINEER)
    with pytest.raises(ConflictError, match="approved already"):
        approvals.approve(sha256, WHY, eve, is_without_validation=True)
    approvals.withdraw(sha256, WHY, eve)
    assert not approvals.is_approved(policy)
    with pytest.raises(NotFoundError):
        approvals.withdraw(sha256, WHY, eve)
    assert approvals.approve(sha256, WHY, eve, is_without_validation=True).approved_by == "eve"
    again = fresh(assembled, assembled.parts.settings.data_dir)
    again.start()
    assert again.is_approved(policy)
    with pytest.raises(NotFoundError):
        approvals.approve("0" * 64, WHY, eve, is_without_validation=True)


@pytest.fixture
def approve_at_once(assembled, approvals, monkeypatch):
    """Withdraws two versions and approves them on two threads, neither before both are checked."""
    barrier, check = threading.Barrier(2), approval_basis.check_version

    def check_together(*arguments):
        check(*arguments)
        barrier.wait(60.0)

    def approve(sha256, name):
        session = assembled.session(name, Role.ENGINEER)
        try:
            approvals.approve(sha256, WHY, session, is_without_validation=True)
        except ConflictError as error:
            return error.code
        return name

    def run(*hashes):
        for sha256 in dict.fromkeys(hashes):
            approvals.withdraw(sha256, WHY, assembled.session("eve", Role.ENGINEER))
        monkeypatch.setattr(approval_basis, "check_version", check_together)
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(approve, hashes, ("eve", "eli")))

    return run


def test_of_two_approvals_of_a_version_at_once_one_is_given(assembled, approvals, approve_at_once):
    sha256 = versions(assembled)["waits-2d"].card.policy_sha256
    before = approvals.trust().serial_count
    found = approve_at_once(sha256, sha256)
    assert "approved" in found
    (by,) = {*found} - {"approved"}
    given = [one for one in approvals.trust().approvals if one.policy_sha256 == sha256]
    assert [one.approved_by for one in given] == [by]
    assert approvals.trust().serial_count == before + 2  # one withdrawal, one approval
    with assembled.parts.database.read() as database:
        assert history(database, sha256)[-1].actor == by


def test_two_approvals_of_two_versions_at_once_are_both_kept(assembled, approvals, approve_at_once):
    here = versions(assembled)
    hashes = [here[name].card.policy_sha256 for name in ("waits-2d", "waits-3d")]
    assert approve_at_once(*hashes) == ["eve", "eli"]
    assert {*hashes} <= {one.policy_sha256 for one in approvals.trust().approvals}
    again = fresh(assembled, assembled.parts.settings.data_dir)
    again.start()
    assert again.trust() == approvals.trust()


@pytest.mark.parametrize("damage", ["no key", "no list", "other key", "torn list"])
def test_a_damaged_folder_stops_the_start(assembled, approvals, tmp_path, damage):
    data_dir = assembled.parts.settings.data_dir
    folder = data_dir / "policy-approvals"
    if damage == "no key":
        (folder / "site.key").unlink()
    elif damage == "no list":
        (folder / "site.json").unlink()
    elif damage == "torn list":
        (folder / "site.json").write_text("{")
    else:
        other = fresh(assembled, tmp_path / "other")
        other.start()
        text = (tmp_path / "other" / "policy-approvals" / "site.key").read_text()
        (folder / "site.key").write_text(text)
    with pytest.raises(ApprovalError, match="policy-approvals"):
        fresh(assembled, data_dir).start()


def test_a_full_disk_changes_nothing(assembled, approvals, monkeypatch):
    policy = assembled.parts.policies.active("2d")
    sha256, eve = policy.card.policy_sha256, assembled.session("eve", Role.ENGINEER)
    before = approvals.trust()

    def refuse(file, trust):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(site_approvals, "_write", refuse)
        with pytest.raises(ConflictError, match=r"nothing has changed: .*No space"):
            approvals.withdraw(sha256, WHY, eve)
    assert approvals.trust() == before
    approvals.withdraw(sha256, WHY, eve)
    assert approvals.trust().serial_count == before.serial_count + 1


def test_a_first_start_that_is_killed_is_begun_again(assembled, tmp_path, monkeypatch):
    killed = fresh(assembled, tmp_path)

    def die(file, trust):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(site_approvals, "_write", die)
        with pytest.raises(KeyboardInterrupt):
            killed.start()
    assert not (tmp_path / "policy-approvals").exists()
    again = fresh(assembled, tmp_path)
    again.start()
    assert len(again.trust().approvals) >= 2
    again.trust().require_successor_of(None)


def test_what_machines_would_not_load_is_not_approved(assembled, approvals, monkeypatch):
    policy = assembled.parts.policies.active("2d")
    sha256, eve = policy.card.policy_sha256, assembled.session("eve", Role.ENGINEER)
    approvals.withdraw(sha256, WHY, eve)

    def refuse(files, spec):
        raise PolicyError(f"{files.folder} uses operator 'Loop'")

    monkeypatch.setattr(approval_basis, "check_version", refuse)
    with pytest.raises(ConflictError, match=r"cannot be approved: .*Loop"):
        approvals.approve(sha256, WHY, eve, is_without_validation=True)
    assert not approvals.is_approved(policy)


def test_the_interface_approves_withdraws_and_deploys_only_what_is_approved(running, ada):
    sha256 = running.parts.policies.active("3d").card.policy_sha256
    with running.client("eve") as eve:

        def approved():
            return sha256 in {a["policy_sha256"] for a in ada.get("/policy-approvals").json()}

        body = {"policy_sha256": sha256, "reason": "a test"}
        try:
            assert eve.post(f"/policies/{sha256}/withdraw", json={"reason": WHY}).status_code == 204
            assert not approved()
            refused = eve.post("/machines/m001/policies/3d/deploy", json=body)
            assert refused.json()["error"]["code"] == "not_approved"
        finally:
            refused = eve.post(f"/policies/{sha256}/approve", json={"reason": WHY})
            assert refused.json()["error"]["code"] == "not_validated"
            assert "has no finished validation" in refused.json()["error"]["message"]
            again = {"reason": WHY, "is_without_validation": True}
            assert eve.post(f"/policies/{sha256}/approve", json=again).status_code == 201
        assert approved()
        token = running.parts.registry.secret_path("m001").read_text().strip()
        headers = {"Authorization": f"Bearer {token}"}
        # The machine says which keys it trusts; the page shows it, and the audit says when that changed.
        key_id = running.parts.approvals.trust().signed_by
        query = {"list": 1, "key": [key_id, "0" * 16]}
        for _ in range(2):
            wanted = eve.get("/machines/m001/policies/wanted", headers=headers, params=query)
        assert sha256 in json.dumps(wanted.json()["trust"])
        shown = {key["key_id"]: key for key in eve.get("/policy-keys").json()}
        assert shown[key_id]["machine_ids"] == ["m001"]
        assert shown[key_id]["made_by"] and shown[key_id]["since_utc"]
        with running.parts.database.read() as session:
            rows = session.scalars(select(Audit).where(Audit.action == "machine.trust")).all()
        assert sum(key_id in row.detail_json for row in rows) == 1
        wrong = {"list": 1, "key": ["no key"]}
        answer = eve.get("/machines/m001/policies/wanted", headers=headers, params=wrong)
        assert answer.status_code == 422


def test_the_key_is_changed_machines_follow_and_the_old_one_is_revoked(assembled, approvals):
    parts, eve = assembled.parts, assembled.session("eve", Role.ENGINEER)
    before = approvals.trust()
    (first,) = approvals.keys()
    newest, old = approvals.rotate(WHY, eve)
    assert (old.key_id, old.is_signing, old.approval_count) == (first.key_id, False, 0)
    assert (newest.is_signing, newest.approval_count) == (True, first.approval_count)
    for policy in parts.policies.present():
        assert approvals.is_approved(policy)
    with pytest.raises(ConflictError, match="is the one that signs"):
        approvals.revoke(newest.key_id, WHY, eve)
    _, revoked = approvals.revoke(old.key_id, WHY, eve)
    assert revoked.is_revoked
    assert (newest.made_by, revoked.revoked_by, first.made_by) == ("eve", "eve", "server")
    assert revoked.revoked_utc is not None and newest.since_utc is not None
    approvals.trust().require_successor_of(before)
    again = fresh(assembled, parts.settings.data_dir)
    again.start()
    assert again.keys() == approvals.keys()
    sha256 = parts.policies.active("2d").card.policy_sha256
    again.withdraw(sha256, WHY, eve)
    again.trust().require_successor_of(before)


@pytest.mark.parametrize("is_listed", [True, False])
def test_a_change_of_the_key_that_is_killed_is_ended_or_undone(
    assembled, approvals, monkeypatch, is_listed
):
    data_dir = assembled.parts.settings.data_dir
    eve, before = assembled.session("eve", Role.ENGINEER), approvals.trust()
    real = site_approvals._write

    def die(file, trust):
        if is_listed:
            real(file, trust)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(site_approvals, "_write", die)
        with pytest.raises(KeyboardInterrupt):
            approvals.rotate(WHY, eve)
    again = fresh(assembled, data_dir)
    again.start()
    assert (again.trust() != before) == is_listed
    assert not (data_dir / "policy-approvals" / "site.key.next").exists()
    again.withdraw(assembled.parts.policies.active("2d").card.policy_sha256, WHY, eve)
    again.trust().require_successor_of(before)


def test_the_command_line_lists_rotates_and_revokes(running, tmp_path, capsys):
    file = tmp_path / "eve.txt"
    file.write_text(PASSWORD, encoding="utf-8")
    login = ("--server", running.url, "--user", "eve", "--password-file", str(file))

    def keys(*arguments):
        code = main(["policy", "keys", *arguments, *login])
        return code, capsys.readouterr()

    code, told = keys("list")
    old = told.out.split()[0]
    assert (code, "signs" in told.out) == (0, True)
    code, told = keys("rotate", "--reason", WHY)
    assert (code, [line.split()[1] for line in told.out.splitlines()]) == (0, ["signs", "trusted"])
    code, told = keys("revoke", "--key", old, "--reason", WHY)
    assert (code, told.out.splitlines()[1].split()[:2]) == (0, [old, "revoked"])
    assert keys("revoke", "--key", old, "--reason", WHY)[0] == 1
    assert keys("rotate")[0] == 1
    with running.client("root") as root:
        actions = {row["action"] for row in root.get("/audit").json()["rows"]}
    assert {"policy.rotate_key", "policy.revoke_key"} <= actions
    with running.client("sue") as sue:
        assert sue.post("/policy-keys/rotate", json={"reason": WHY}).status_code == 403


def removed(assembled):
    """The site's key is lost with its folder, and the server starts with a new one."""
    shutil.rmtree(assembled.parts.settings.data_dir / "policy-approvals")
    again = fresh(assembled, assembled.parts.settings.data_dir)
    again.start()
    return again


def versions(assembled):
    return {p.card.policy_id: p for p in assembled.parts.policies.present()}


def test_a_new_key_approves_only_what_came_with_the_software(assembled, approvals, monkeypatch):
    monkeypatch.setattr(approval_basis, "check_in_child", lambda files: None)
    parts, eve = assembled.parts, assembled.session("eve", Role.ENGINEER)
    here = versions(assembled)
    uploaded = parts.settings.data_dir / "uploaded-policies" / "brought-2d"
    write_policy(uploaded, Mode.PLANAR, 0.4242)
    (uploaded / "upload.json").write_text('{"uploaded_by": "eve", "reason": "new"}')
    try:
        parts.policies.look_again()
        brought = versions(assembled)["brought-2d"]
        approvals.approve(brought.card.policy_sha256, WHY, eve, is_without_validation=True)
        approvals.withdraw(here["waits-2d"].card.policy_sha256, WHY, eve)
        approvals.approve(here["waits-2d"].card.policy_sha256, WHY, eve, is_without_validation=True)
        approvals.retire(here["waits-3d"].card.policy_sha256, WHY, eve)
        again = removed(assembled)
        approved = {name for name, p in versions(assembled).items() if again.is_approved(p)}
        assert approved == set(here) - {"waits-2d", "waits-3d"}
        assert parts.policies.view(brought.card.policy_sha256).state == "uploaded"
    finally:
        shutil.rmtree(uploaded)
        parts.policies.look_again()


@pytest.mark.parametrize("end", ["withdraw", "retire"])
def test_a_retired_version_that_the_list_still_holds_leaves_it(assembled, approvals, end):
    eve = assembled.session("eve", Role.ENGINEER)
    policy = versions(assembled)["waits-3d"]
    sha256 = policy.card.policy_sha256
    with assembled.parts.database.write() as database:
        change_state(database, sha256, PolicyState.RETIRED, actor="eve", reason=WHY)
    assert approvals.is_approved(policy)
    body = DeployRequest(policy_sha256=sha256, reason=WHY)
    with pytest.raises(ConflictError, match="is retired, only approved"):
        assembled.parts.deployments.deploy("m001", Mode.SPATIAL, body, eve)
    getattr(approvals, end)(sha256, WHY, eve)
    assert not approvals.is_approved(policy)
    assert assembled.parts.policies.view(sha256).state == "retired"


def test_a_version_is_not_deployed_whose_approval_ends_meanwhile(assembled, approvals, monkeypatch):
    eve = assembled.session("eve", Role.ENGINEER)
    sha256 = versions(assembled)["waits-3d"].card.policy_sha256
    deployments = assembled.parts.deployments
    catch_up = approvals.catch_up

    def end():
        catch_up()
        approvals.retire(sha256, WHY, eve)

    monkeypatch.setattr(approvals, "catch_up", end)
    body = DeployRequest(policy_sha256=sha256, reason=WHY)
    with pytest.raises(ConflictError, match="is retired, only approved"):
        deployments.deploy("m001", Mode.SPATIAL, body, eve)
    assert not [d for d in deployments.list("m001") if d.policy_sha256 == sha256]


def test_a_version_that_is_deployed_meanwhile_is_not_retired(assembled, approvals, monkeypatch):
    eve = assembled.session("eve", Role.ENGINEER)
    sha256 = versions(assembled)["waits-3d"].card.policy_sha256
    answers = iter([[], ["m001 is to switch to it"]])
    monkeypatch.setattr(site_approvals, "machines_that_need", lambda *_: next(answers))
    with pytest.raises(ConflictError, match="m001 is to switch to it"):
        approvals.retire(sha256, WHY, eve)
    assert assembled.parts.policies.view(sha256).state == "approved"
    assert approvals.is_approved(versions(assembled)["waits-3d"])
