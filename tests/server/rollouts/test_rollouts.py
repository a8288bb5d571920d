"""Rollouts in a server: asked, tested, paused, moved on, rolled back; a restart goes on."""

from datetime import timedelta

import pytest

from cli.main import main
from machine.conventions import Mode
from machine.messages import EventKind
from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.rollouts import rollouts as rollouts_module
from server.rollouts.rollout_views import RolloutRequest
from server.rollouts.rollouts import Rollouts
from tests.server.rollouts.rollout_yard import RolloutYard
from tests.server.server_bench import PASSWORD

WHY = "a test"


@pytest.fixture
def yard(assembled):
    return RolloutYard(assembled)


def request(yard, *stages, **changes):
    values = {"policy_sha256": yard.new, "reason": "retrained", "deadline_s": 600.0}
    return RolloutRequest(**(values | {"stages": stages or ONE_BY_ONE} | changes))


ONE_BY_ONE = ({"machine_ids": ["m001"]}, {"machine_ids": ["m002"]})


def start(yard, *stages, **changes):
    return yard.rollouts.start(Mode.PLANAR, request(yard, *stages, **changes), yard.eve)


def look(yard, rollout):
    yard.rollouts.advance(rollout.rollout_id)
    return yard.rollouts.view(rollout.rollout_id)


def states(view):
    return {one.machine_id: one.state for one in view.machines}


def wanted(yard, machine_id):
    found = yard.parts.deployments.list(machine_id)
    return found[0].policy_sha256 if found else None


def test_a_good_version_passes_stage_by_stage_and_is_stable(yard):
    begun = start(yard)
    assert states(begun) == {"m001": "asked", "m002": "waiting"}
    yard.switch("m001")
    yard.throw("m001", 11)
    assert states(look(yard, begun))["m001"] == "testing"
    assert wanted(yard, "m002") is None
    candidate = yard.rollouts.channels()[0].candidate_policy_id
    yard.throw("m001", 1)
    second = look(yard, begun)
    assert (second.stage_count, states(second)) == (1, {"m001": "passed", "m002": "asked"})
    yard.switch("m002")
    yard.throw("m002", 12)
    ended = look(yard, begun)
    assert ended.state == "completed"
    assert ended.machines[0].before.throw_count == 40
    planar = yard.rollouts.channels()[0]
    assert (planar.candidate_policy_id, planar.stable_policy_id) == (None, candidate)
    audit = yard.parts.audit.verify()
    assert audit.is_intact


def test_worse_throws_take_every_machine_back_with_the_numbers(yard):
    begun = start(yard, {"machine_ids": ["m001", "m002"]})
    yard.switch("m001")
    yard.throw("m001", 12, ratio=4.0)
    ended = look(yard, begun)
    assert ended.state == "rolled_back"
    sentence = ended.steps[-1].sentence
    assert sentence.startswith("m001, ")
    assert "spread 0." in sentence
    assert "with the version before 0.0" in sentence
    # Also the one that has not answered yet: it does not switch later.
    assert {wanted(yard, one) for one in ("m001", "m002")} == {yard.old}
    rows = yard.parts.deployments.list("m001")
    look(yard, begun)
    assert yard.parts.deployments.list("m001") == rows
    with pytest.raises(ConflictError, match="is rolled back"):
        yard.rollouts.resume(begun.rollout_id, WHY, yard.eve)


def test_aborts_count_where_the_policy_is_their_reason_or_nobody_knows(yard):
    begun = start(yard, {"machine_ids": ["m001", "m002"]})
    yard.switch("m001")
    yard.throw("m001", 6, outcome="aborted", is_own=False)
    yard.throw("m001", 6)
    assert states(look(yard, begun))["m001"] == "testing"
    for is_own in (None, True):
        yard.throw("m001", 3, outcome="aborted", is_own=is_own)
    ended = look(yard, begun)
    assert ended.state == "rolled_back"
    assert "failed, the gate allows 1 %" in ended.steps[-1].sentence


def test_a_machine_that_never_answers_pauses_it_until_a_person_decides(yard, monkeypatch):
    begun = start(yard)
    now = utc_now()
    with monkeypatch.context() as later:
        later.setattr(rollouts_module, "utc_now", lambda: now + timedelta(seconds=601))
        paused = look(yard, begun)
    assert paused.state == "paused"
    assert "m001 has not switched within 600 s" in paused.steps[-1].sentence
    (alert,) = yard.rollouts.verdicts()
    assert "is paused: m001 has not" in alert.text
    assert list(yard.rollouts.verdicts()) == []
    promoted = yard.rollouts.promote(begun.rollout_id, "m001 is in repair", yard.eve)
    assert (promoted.state, promoted.stage_count) == ("running", 1)
    (alert,) = yard.rollouts.verdicts()
    assert alert.text is None


def test_what_a_machine_refuses_pauses_it_and_abort_takes_all_back(yard):
    begun = start(yard, {"machine_ids": ["m001", "m002"]})
    yard.switch("m001")
    yard.tell("m002", EventKind.POLICY_REFUSED, detail="not signed")
    paused = look(yard, begun)
    assert (paused.state, states(paused)["m002"]) == ("paused", "error")
    assert paused.steps[-1].sentence == "m002 refused it: not signed."
    ended = yard.rollouts.abort(begun.rollout_id, "another day", yard.eve)
    assert ended.state == "aborted"
    assert wanted(yard, "m001") == yard.old


def test_a_restart_goes_on_and_a_cut_off_rollback_is_done_once(yard):
    begun = start(yard, {"machine_ids": ["m001"]})
    yard.switch("m001")
    yard.throw("m001", 12, ratio=4.0)
    parts = yard.parts

    def again():
        return Rollouts(
            parts.database,
            parts.audit,
            parts.registry,
            parts.policies,
            parts.deployments,
            parts.hub,
        )

    def die(*_):
        raise KeyboardInterrupt

    cut = again()
    cut.on_change.append(die)
    with pytest.raises(KeyboardInterrupt):
        cut.advance(begun.rollout_id)
    assert cut.view(begun.rollout_id).state == "running"
    asked = parts.deployments.list("m001")
    assert wanted(yard, "m001") == yard.old
    restarted = again()
    restarted.advance(begun.rollout_id)
    assert restarted.view(begun.rollout_id).state == "rolled_back"
    assert parts.deployments.list("m001") == asked


def test_what_cannot_begin_is_refused_with_the_reason(yard):
    with pytest.raises(ConflictError, match="has no machine"):
        start(yard, {"tags": ["nowhere"]})
    with pytest.raises(ConflictError, match="has no machine"):
        start(yard, {"machine_ids": ["m001"]}, {"machine_ids": ["m001"]})
    with pytest.raises(NotFoundError):
        start(yard, {"machine_ids": ["m999"]})
    yard.parts.registry.get("m002").tags = ("yard",)
    begun = start(yard, {"tags": ["yard"]})
    assert begun.stages[0].machine_ids == ("m002",)
    with pytest.raises(ConflictError, match="is open"):
        start(yard)
    yard.parts.approvals.withdraw(yard.new, WHY, yard.eve)
    yard.rollouts.abort(begun.rollout_id, WHY, yard.eve)
    with pytest.raises(ConflictError, match="not approved"):
        start(yard)


def test_interface_and_command_line_start_show_and_abort(running, tmp_path, capsys):
    file = tmp_path / "eve.txt"
    file.write_text(PASSWORD, encoding="utf-8")
    login = ("--server", running.url, "--user", "eve", "--password-file", str(file))

    def rollout(*arguments):
        code = main(["policy", "rollout", *arguments, *login])
        return code, "".join(capsys.readouterr())

    assert rollout("start", "--policy", "waits-2d", "--reason", WHY)[0] == 1
    assert "no rollout is open" in rollout("pause", "--reason", WHY)[1]
    stages = ("--stage", "m001", "m002")
    code, text = rollout("start", "--policy", "waits-2d", *stages, "--reason", WHY)
    assert (code, "waits-2d in 2d: running, stage 1 of 2" in text) == (0, True), text
    code, text = rollout("pause", "--reason", "lunch")
    assert (code, "eve: lunch" in text) == (0, True)
    with running.client("sue") as sue:
        (view,) = [r for r in sue.get("/policy-rollouts").json() if r["state"] == "paused"]
        path = f"/policy-rollouts/{view['rollout_id']}"
        assert sue.get(path).json()["steps"][-1]["sentence"] == "lunch"
        assert sue.post(f"{path}/change/abort", json={"reason": WHY}).status_code == 403
    code, text = rollout("abort", "--reason", WHY)
    assert (code, "2d: aborted" in text) == (0, True)
    assert rollout("status")[0] == 3
