"""Aim corrections on a running server: proposed, applied, held by plans, undone, withdrawn."""

import numpy as np
import pytest
from sqlalchemy import delete

from machine.messages import ThrowState
from machine.spec import load_spec
from server.clock import new_id, utc_now
from server.store.aim_tables import AimCorrection
from server.store.models import Plan, Throw
from tests.server.gap_bench import forget_throws
from tests.server.throws.test_throw_service import code, make_plan
from tests.waiting import wait_for

AIM = "/machines/m001/aim"


def thrown(running, policy_sha256: str, count: int, miss_m: float, aim=None, material=None) -> None:
    """Throws at 5.6 to 7 m that land this long, each with its plan."""
    rng = np.random.default_rng(count)
    with running.parts.database.write() as database:
        for _ in range(count):
            plan_id, now, range_m = new_id(), utc_now(), float(rng.uniform(5.6, 7.0))
            shared = {
                "plan_id": plan_id,
                "machine_id": "m001",
                "session_id": "s",
                "created_utc": now,
                "mode": "2d",
                "target_x_m": range_m,
                "target_y_m": 0.0,
                "target_z_m": 0.0,
                "policy_sha256": policy_sha256,
                "policy_id": "p",
            }
            plan = Plan(
                **shared,
                created_by="ada",
                expires_utc=now,
                state="ready",
                model_sha256=load_spec().sha256,
                twin_profile_version=0,
                refusals=[],
                prediction=None,
                start_rad_m=[],
                plan_json=None,
                aim=aim,
                material=material,
                calibration_sha256="c" * 64,
            )
            along, across = rng.normal(0.0, 0.05, 2).tolist()
            throw = Throw(
                **shared,
                throw_id=new_id(),
                operator="ada",
                epoch_count=1,
                range_m=range_m,
                phase="ended",
                outcome="landed",
                predicted_downrange_error_m=0.0,
                predicted_crossrange_error_m=0.0,
                predicted_sd_downrange_m=0.05,
                predicted_sd_crossrange_m=0.05,
                measured_downrange_error_m=miss_m + along,
                measured_crossrange_error_m=across,
            )
            database.add_all([plan, throw])


def two_d(view):
    return next(mode for mode in view["modes"] if mode["mode"] == "2d")


@pytest.fixture
def policy_sha256(running, machine, ada):
    """Of the version on board; before and afterwards there is no throw or correction."""
    wait_for(lambda: running.parts.registry.get("m001").state)
    forget_throws(running.parts)
    yield machine.state_message().policy_sha256["2d"]
    with running.parts.database.write() as database:
        database.execute(delete(AimCorrection))
        database.execute(delete(Throw).where(Throw.session_id == "s"))


def test_a_correction_is_proposed_applied_held_by_plans_and_undone(
    running, machine, ada, policy_sha256
):
    thrown(running, policy_sha256, 19, 0.3)
    thrown(running, policy_sha256, 5, 1.0, material={"name": "gravel"})
    assert "19 measured throws" in two_d(ada.get(AIM).json())["problem"]
    thrown(running, policy_sha256, 21, 0.3)
    shown = two_d(ada.get(AIM).json())
    proposal = shown["proposal"]
    assert (shown["in_force"], proposal["throw_count"], shown["problem"]) == (None, 40, "")
    assert proposal["gain_low_m"] > 0.15
    assert np.allclose(proposal["table"]["downrange_m"], 0.3, atol=0.05)
    body = {"proposal_sha256": shown["proposal_sha256"]}
    assert ada.post(f"{AIM}/2d/apply", json=body).status_code == 403
    assert ada.post("/machines/m001/lease").status_code == 200
    before_id = make_plan(ada)
    with running.client("eve") as eve:
        other = eve.post(f"{AIM}/2d/apply", json={"proposal_sha256": "0" * 64})
        assert code(other) == (409, "aim_proposal_changed")
        applied = eve.post(f"{AIM}/2d/apply", json=body)
        assert applied.status_code == 200, applied.text
        version = two_d(applied.json())["in_force"]
        assert (version["version_count"], version["created_by"]) == (1, "eve")
        # Nothing more is to gain from the same throws.
        assert two_d(applied.json())["proposal"] is None
        # A plan of before is not armed any more, a new one holds the correction and its hash has it.
        assert code(ada.post(f"/plans/{before_id}/arm", json={})) == (409, "aim_mismatch")
        plan_id = make_plan(ada)
        aim = ada.get(f"/plans/{plan_id}").json()["aim"]
        assert aim["version_count"] == 1
        assert aim["downrange_m"] == pytest.approx(0.3, abs=0.05)
        assert ada.post(f"/plans/{plan_id}/arm", json={}).status_code == 200
        armed = next(c for c in reversed(machine.commands) if c.kind == "arm")
        assert armed.plan.aim is not None
        assert armed.plan.aim.model_dump(mode="json") == aim
        assert ada.post("/machines/m001/disarm").status_code < 300
        wait_for(lambda: machine.state is ThrowState.DISARMED)
        # Throws with it hit; what they would have missed without is still what is learned.
        thrown(running, policy_sha256, 30, 0.0, aim)
        assert two_d(ada.get(AIM).json())["proposal"] is None
        undone = eve.post(f"{AIM}/2d/undo").json()
        assert two_d(undone)["in_force"] is None
        assert undone["history"][0]["end_reason"] == "undone"
        assert two_d(undone)["proposal"]["throw_count"] == 70
        assert code(eve.post(f"{AIM}/2d/undo")) == (409, "no_aim_correction")
    assert code(ada.post(f"/plans/{plan_id}/arm", json={})) == (409, "aim_mismatch")


def test_another_calibration_withdraws_a_correction(running, machine, ada, policy_sha256):
    thrown(running, policy_sha256, 40, 0.3)
    body = {"proposal_sha256": two_d(ada.get(AIM).json())["proposal_sha256"]}
    with running.client("eve") as eve:
        eve.post(f"{AIM}/2d/apply", json=body)
    machine.calibration_sha256 = "d" * 64
    wait_for(lambda: running.parts.registry.get("m001").state.calibration_sha256 == "d" * 64)
    view = ada.get(AIM).json()
    assert two_d(view)["in_force"] is None
    assert "0 measured throws" in two_d(view)["problem"]
    assert view["history"][0]["end_reason"] == "withdrawn: another calibration"
    assert view["history"][0]["ended_by"] == "server"
    machine.calibration_sha256 = "c" * 64
    wait_for(lambda: running.parts.registry.get("m001").state.calibration_sha256 == "c" * 64)
    # It does not come back by itself.
    assert two_d(ada.get(AIM).json())["in_force"] is None
