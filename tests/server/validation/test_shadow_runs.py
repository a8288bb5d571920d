"""A version run over recorded throws, in the real process: what is kept of it, and what is refused."""

from datetime import UTC, datetime

import pytest

from evaluation.campaigns import open_campaign
from evaluation.log_campaign import RecordedMachine, record_campaign
from machine.conventions import Mode
from tests.server.gap_bench import add_throws, forget_throws

pytestmark = pytest.mark.begins_first


def record(policies, folder):
    """Logs of two 2D throws of m001, thrown in the twin."""
    campaign = open_campaign(
        mode=Mode.PLANAR, plant="twin", targets="7,7.5", throws=1, seed=1, unit_seed=0,
        policies=policies, policy=None, calibration=None, profile=None,
    )  # fmt: skip
    machine = RecordedMachine("twin", 0, None, "m001")
    return record_campaign([campaign], machine, None, 2, 1, folder).paths


def test_a_version_is_run_over_recorded_throws(running, ada, swing_policies, tmp_path):
    parts = running.parts
    forget_throws(parts)
    shas = {p.card.policy_id: p.card.policy_sha256 for p in parts.policies.present()}
    throw_ids = add_throws(parts, 2, mode=Mode.PLANAR, logs=record(swing_policies, tmp_path))
    add_throws(parts, 1, mode=Mode.PLANAR)
    path = f"/policies/{shas['waits-2d']}/shadow"
    body = {"machine_id": "m001", "throws_count": 3}
    assert ada.post(path, json=body).status_code == 403
    with running.client("eve") as eve:
        reply = eve.post(path, json=body)
        assert reply.status_code == 201, reply.text
        kept = reply.json()
        found = kept["report"]
        # The version stands still and never lets go; the one that flew did. The empty log is left out.
        assert len(found["throws"]) == len(throw_ids)
        for throw in found["throws"]:
            assert throw["candidate"]["outcome"] == "no_release"
            assert throw["shown_release_s"] is None
            assert throw["flown_release_s"] > 0.0
            assert throw["flown"]["outcome"] == "landed"
            assert throw["action_difference_rms_ratio"] > 0.1
        # It is kept: anyone who may look reads it later.
        assert ada.get(f"/policy-shadows/{kept['shadow_id']}").json() == kept
        listed = ada.get(f"/policies/{shas['waits-2d']}/shadows").json()
        summary = {name: value for name, value in kept.items() if name != "report"}
        assert listed[0] == summary
        assert (summary["created_by"], summary["machine_id"]) == ("eve", "m001")
        assert summary["figures"]["candidate"]["landed_count"] == 0
        assert summary["figures"]["flown"]["landed_count"] == len(throw_ids)
        assert ada.get(f"/policy-shadows/{'0' * 36}").status_code == 404

        # All machines, or a period.
        everyone = eve.post(path, json={"throws_count": 3}).json()
        assert everyone["machine_id"] is None and everyone["report"] == found
        old = {"until_utc": datetime(2020, 1, 1, tzinfo=UTC).isoformat()}
        empty = eve.post(path, json=old)
        assert (empty.status_code, empty.json()["error"]["code"]) == (409, "no_throws")
        assert "in this period" in empty.json()["error"]["message"]
        assert len(ada.get(f"/policies/{shas['waits-2d']}/shadows").json()) == 2

        none = eve.post(path, json={"machine_id": "m002"})
        assert (none.status_code, none.json()["error"]["code"]) == (409, "no_throws")
        assert "m002" in none.json()["error"]["message"]
        gone = eve.post(f"/policies/{'0' * 64}/shadow", json=body)
        assert (gone.status_code, gone.json()["error"]["code"]) == (404, "no_policy")
        with parts.shadows._one:
            busy = eve.post(path, json=body)
        assert (busy.status_code, busy.json()["error"]["code"]) == (429, "shadow_busy")
