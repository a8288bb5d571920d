"""The life of a version: allowed steps, refused ones, and what signed list and history share."""

import itertools

import pytest
from sqlalchemy import delete, select

from machine.messages import EventKind
from server.deployments.site_approvals import SiteApprovals
from server.errors import ConflictError, NotFoundError
from server.plans.policy_life import NEXT_STATES, change_state, history
from server.schemas.console import Role
from server.schemas.policies import PolicyState
from server.store.models import Policy, PolicyTransition
from tests.server.server_bench import wait_for

WHY = "for a test"


@pytest.fixture
def database(assembled):
    assembled.parts.policies.refresh()
    return assembled.parts.database


@pytest.fixture
def sha256(assembled, database):
    return assembled.parts.policies.active("2d").card.policy_sha256


def step(database, sha256, to_state, **more):
    with database.write() as session:
        return change_state(session, sha256, to_state, actor="eve", reason=WHY, **more)


def steps(database, sha256):
    with database.read() as session:
        return [row.to_state for row in history(session, sha256)]


def test_a_version_that_is_found_is_uploaded_once(assembled, database, sha256):
    assembled.parts.policies.refresh()
    assert steps(database, sha256) == ["uploaded"]
    with database.read() as session:
        (first,) = history(session, sha256)
    assert (first.actor, first.from_state) == ("server", None)
    assert "policies folder" in first.reason


def test_every_step_that_the_table_lacks_is_refused_and_changes_nothing(database, sha256):
    """All pairs of states, each from a version that is brought there by allowed steps."""
    ways = {PolicyState.UPLOADED: ()}
    while len(ways) < len(PolicyState):
        for state, way in list(ways.items()):
            for following in sorted(NEXT_STATES[state]):
                ways.setdefault(following, (*way, following))
    for number, (state, to_state) in enumerate(itertools.product(PolicyState, PolicyState)):
        name = f"{number:064x}"
        with database.write() as session:
            card = session.get(Policy, sha256)
            session.add(
                Policy(
                    policy_sha256=name,
                    policy_id=f"p{number}",
                    mode=card.mode,
                    card=card.card,
                    first_seen_utc=card.first_seen_utc,
                )
            )
        for one in (PolicyState.UPLOADED, *ways[state]):
            step(database, name, one)
        before = steps(database, name)
        if to_state in NEXT_STATES[state]:
            step(database, name, to_state)
            assert steps(database, name) == [*before, to_state]
        else:
            with pytest.raises(ConflictError, match=f"is {state} and cannot become {to_state}"):
                step(database, name, to_state)
            assert steps(database, name) == before
    with pytest.raises(ConflictError, match="not known here yet"), database.write() as session:
        session.execute(PolicyTransition.__table__.delete())
        change_state(session, sha256, PolicyState.APPROVED, actor="eve", reason=WHY)
    with pytest.raises(NotFoundError):
        step(database, "f" * 64, PolicyState.UPLOADED)


def test_evidence_comes_back_as_it_was_given(database, sha256):
    evidence = {"spread_m": 0.04, "n": 30, "gates": {"landed": True}}
    step(database, sha256, PolicyState.VALIDATING, evidence=evidence)
    with database.read() as session:
        assert history(session, sha256)[-1].evidence == evidence


def test_a_withdrawn_version_is_what_it_was_before_its_approval(assembled, database, sha256):
    eve = assembled.session("eve", Role.ENGINEER)
    approvals = assembled.parts.approvals
    approvals.start()
    approvals.withdraw(sha256, WHY, eve)
    step(database, sha256, PolicyState.VALIDATING)
    step(database, sha256, PolicyState.VALIDATED)
    approvals.approve(sha256, "measured", eve, is_without_validation=True)
    approvals.withdraw(sha256, WHY, eve)
    assert steps(database, sha256)[-4:] == ["validating", "validated", "approved", "validated"]
    with database.read() as session:
        row = history(session, sha256)[-2]
    assert (row.actor, row.reason) == ("eve", "measured")
    assert row.evidence["list_count"] == approvals.trust().serial_count - 1


def test_a_start_adds_what_the_signed_list_shows(assembled, database, sha256):
    """A server that was killed between list and history; the list is what machines go by."""
    parts, eve = assembled.parts, assembled.session("eve", Role.ENGINEER)
    approvals = parts.approvals
    approvals.start()
    assert steps(database, sha256) == ["uploaded", "approved"]
    with database.write() as session:
        newest = session.scalars(
            select(PolicyTransition).where(
                PolicyTransition.policy_sha256 == sha256,
                PolicyTransition.to_state == PolicyState.APPROVED.value,
            )
        ).one()
        session.delete(newest)

    def again():
        found = SiteApprovals(
            parts.database, parts.audit, parts.policies, "yard", parts.settings.data_dir
        )
        found.start()
        return found

    again()
    assert steps(database, sha256) == ["uploaded", "approved"]
    again()
    assert steps(database, sha256) == ["uploaded", "approved"]
    approvals.withdraw(sha256, WHY, eve)
    step(database, sha256, PolicyState.APPROVED)
    found = again()
    assert steps(database, sha256)[-1] == "uploaded"
    assert not found.is_approved(parts.policies.find(sha256))


@pytest.mark.parametrize("is_known", [True, False])
def test_an_approval_that_the_history_lacks_can_be_withdrawn(assembled, database, sha256, is_known):
    """The list of approvals was kept, and the database is another one."""
    parts, eve = assembled.parts, assembled.session("eve", Role.ENGINEER)
    parts.approvals.start()
    with database.write() as session:
        session.execute(
            delete(PolicyTransition).where(
                PolicyTransition.policy_sha256 == sha256,
                *([PolicyTransition.to_state == PolicyState.APPROVED.value] if is_known else []),
            )
        )
        if not is_known:
            session.execute(delete(Policy).where(Policy.policy_sha256 == sha256))
    parts.approvals.withdraw(sha256, WHY, eve)
    assert not parts.approvals.is_approved(parts.policies.find(sha256))
    if is_known:
        assert steps(database, sha256) == ["uploaded", "approved", "uploaded"]


def test_where_two_people_are_asked_for_the_uploader_may_not_approve(assembled, database, sha256):
    parts, eve = assembled.parts, assembled.session("eve", Role.ENGINEER)
    approvals = SiteApprovals(
        parts.database,
        parts.audit,
        parts.policies,
        "yard",
        parts.settings.data_dir,
        is_four_eyes=True,
    )
    approvals.start()
    approvals.withdraw(sha256, WHY, eve)
    with database.write() as session:
        first = session.scalars(
            select(PolicyTransition).where(PolicyTransition.policy_sha256 == sha256)
        ).first()
        first.actor = "eve"
    with pytest.raises(ConflictError, match=r"eve has uploaded swing-2d; another engineer"):
        approvals.approve(sha256, WHY, eve, is_without_validation=True)
    assert steps(database, sha256)[-1] == "uploaded"
    approvals.approve(
        sha256, WHY, assembled.session("ada", Role.ENGINEER), is_without_validation=True
    )
    assert steps(database, sha256)[-1] == "approved"


def test_what_is_needed_is_not_retired_and_the_retired_stays_so(running, machine, add_version):
    sha256 = add_version("retiring-2d")
    with running.client("eve") as eve:

        def ask(verb):
            more = {"is_without_validation": True} if verb == "approve" else {}
            return eve.post(f"/policies/{sha256}/{verb}", json={"reason": WHY} | more)

        def refusal():
            reply = ask("retire")
            return "" if reply.is_success else reply.json()["error"]["message"]

        assert ask("approve").status_code == 201
        deploy = {"reason": WHY, "policy_sha256": sha256}
        row = eve.post("/machines/m001/policies/2d/deploy", json=deploy).json()
        assert "m001 is to switch to it" in refusal()
        data = {"mode": "2d", "policy_sha256": sha256}
        machine.event(EventKind.POLICY_SWITCHED, **data, deployment_count=row["deployment_count"])
        wait_for(lambda: "m001 runs it" in refusal())
        machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256="d" * 64)
        wait_for(lambda: "m001 may go back to it" in refusal())
        machine.event(EventKind.POLICY_SWITCHED, mode="2d", policy_sha256="e" * 64)
        wait_for(lambda: refusal() == "")
        assert eve.get(f"/policies/{sha256}").json()["state"] == "retired"
        assert sha256 not in {a["policy_sha256"] for a in eve.get("/policy-approvals").json()}
        assert "is retired and cannot become approved" in ask("approve").json()["error"]["message"]
        assert "is retired and cannot become retired" in ask("retire").json()["error"]["message"]
        told = eve.get(f"/policies/{sha256}/history").json()
        assert [one["to_state"] for one in told] == ["uploaded", "approved", "retired"]
        assert told[-1]["actor"] == "eve"
        active = eve.get("/policies").json()[0]["policy_sha256"]
        words = eve.post(f"/policies/{active}/retire", json={"reason": WHY}).json()["error"]
        assert "active.json of the policies folder names it" in words["message"]
        with running.client("sue") as sue:
            asked = sue.post(f"/policies/{sha256}/retire", json={"reason": WHY})
            assert asked.status_code == 403


@pytest.fixture
def add_version(running):
    """Put a version into the running server's policies folder; gone afterwards."""
    import shutil

    from machine.conventions import Mode
    from tests.runtime.quick_policy import write_policy

    folders = []

    def add(name):
        folder = running.settings.policies_dir / name
        folders.append(folder)
        sha256 = write_policy(folder, Mode.PLANAR, 0.2 + 0.01 * len(folders))
        with running.client("eve") as eve:
            wait_for(lambda: eve.get(f"/policies/{sha256}").is_success)
        return sha256

    yield add
    for folder in folders:
        shutil.rmtree(folder)
