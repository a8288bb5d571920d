import numpy as np
import pytest
from sqlalchemy import delete, select

from server.clock import new_id, utc_now
from server.drift import drift_watch
from server.drift.drift_watch import DriftWatch
from server.schemas.alerts import AlertRule
from server.store.models import MachinePolicy, Throw
from tests.server.server_bench import wait_for

SD_M = 0.1


class Yard:
    """Machine m001 with a version on board, and throws that are put into its history."""

    def __init__(self, assembled):
        self.parts = assembled.parts
        self.parts.registry.get("m001").is_listed = True
        self.watch = DriftWatch(
            self.parts.database, self.parts.registry, self.parts.machine_policies
        )
        self.rng = np.random.default_rng(3)

    def board(self, policy: str) -> None:
        with self.parts.database.write() as database:
            database.add(
                MachinePolicy(
                    machine_id="m001", mode="2d", policy_sha256=policy * 64, since_utc=utc_now()
                )
            )
        self.watch.note("m001")

    def throw(self, count: int, *, bias_m=0.0, policy="a", range_m=9.0, **changes) -> None:
        """Throws that the preview expects 0.2 m long at 9 m, more and with more spread further out."""
        scale = range_m / 9.0
        with self.parts.database.write() as database:
            for along, across in self.rng.standard_normal((count, 2)) * SD_M * scale:
                values = {
                    "throw_id": new_id(),
                    "machine_id": "m001",
                    "plan_id": "p",
                    "session_id": "s",
                    "created_utc": utc_now(),
                    "operator": "ada",
                    "epoch_count": 1,
                    "mode": "2d",
                    "target_x_m": range_m,
                    "target_y_m": 0.0,
                    "target_z_m": 0.0,
                    "range_m": range_m,
                    "policy_id": policy,
                    "policy_sha256": policy * 64,
                    "phase": "ended",
                    "outcome": "landed",
                    "predicted_downrange_error_m": 0.2 * scale,
                    "predicted_crossrange_error_m": 0.0,
                    "predicted_sd_downrange_m": SD_M * scale,
                    "predicted_sd_crossrange_m": SD_M * scale,
                    "measured_downrange_error_m": 0.2 * scale + float(along) + bias_m,
                    "measured_crossrange_error_m": float(across),
                }
                database.add(Throw(**(values | changes)))
        self.watch.note("m001")

    def text(self) -> str | None:
        (verdict,) = (v for v in self.watch.verdicts() if v.subject.machine_id == "m001")
        assert verdict.subject.rule is AlertRule.DRIFT
        return verdict.text


@pytest.fixture
def yard(assembled) -> Yard:
    found = Yard(assembled)
    found.board("a")
    return found


def test_throws_that_the_preview_expects_are_no_drift_at_any_range(yard):
    yard.throw(100)
    yard.throw(60, range_m=12.0)
    assert yard.text() is None


def test_a_bias_is_found_and_said_and_ends_with_another_version(yard):
    yard.throw(150)
    assert yard.text() is None
    yard.throw(60, bias_m=-0.2)
    text = yard.text()
    assert text is not None
    assert text.startswith("2D throws land shorter than predicted and than before")
    yard.board("b")
    assert yard.text() is None


def test_only_machines_with_news_are_judged(yard):
    assert yard.text() is None
    assert list(yard.watch.verdicts()) == []


def test_a_machine_whose_test_failed_is_tested_again_and_holds_up_no_other(yard, monkeypatch):
    def view(machine_id: str, _: object):
        if machine_id == "m001":
            raise RuntimeError("the database is away")
        return real(machine_id, _)

    monkeypatch.setattr(drift_watch, "RETRY_S", 0.0)
    real = yard.parts.machine_policies.view
    yard.parts.registry.get("m002").is_listed = True
    yard.watch.note("m002")
    with monkeypatch.context() as patch:
        patch.setattr(yard.parts.machine_policies, "view", view)
        assert "m002" in [verdict.subject.machine_id for verdict in yard.watch.verdicts()]
    assert yard.text() is None
    assert list(yard.watch.verdicts()) == []


def test_throws_without_a_prediction_or_of_others_are_left_out(yard):
    yard.throw(150)
    yard.throw(60, bias_m=-0.2, predicted_sd_downrange_m=None)
    yard.throw(60, bias_m=-0.2, policy="b")
    yard.throw(60, bias_m=-0.2, mode="3d")
    yard.throw(60, bias_m=-0.2, machine_id="m002")
    yard.throw(60, bias_m=-0.2, predicted_sd_downrange_m=0.0)
    assert yard.text() is None


def test_a_drift_opens_an_alert_of_a_running_server(running, ada):
    """The parts hear of each other: a throw's news reaches the test, and its verdict the alerts."""
    yard = Yard(running)
    yard.board("c")
    yard.throw(150, policy="c")
    yard.throw(60, bias_m=-0.2, policy="c")
    with running.parts.database.read() as database:
        throw_id = database.scalars(
            select(Throw.throw_id).order_by(Throw.throw_id.desc()).limit(1)
        ).one()
    running.parts.throws.publish(throw_id)
    found = wait_for(lambda: ada.get("/alerts", params={"rule": "drift"}).json()["rows"])
    assert found[0]["machine_id"] == "m001"
    with running.parts.database.write() as database:
        database.execute(delete(Throw).where(Throw.policy_sha256 == "c" * 64))
        database.execute(delete(MachinePolicy).where(MachinePolicy.policy_sha256 == "c" * 64))
    for listener in running.parts.throws.on_change:
        listener("m001")
    wait_for(lambda: not ada.get("/alerts", params={"rule": "drift"}).json()["rows"])
