"""Diagnoses of drifts: what they take, who starts them, and that a drift has one."""

from collections.abc import Iterator

import pytest
from sqlalchemy import delete, select

from server.accounts.audit_chain import SERVER
from server.drift.drift_diagnosis import DIAGNOSED_COUNT
from server.store.models import GapRun, MachinePolicy, Throw
from tests.server import gap_fakes
from tests.server.drift.test_drift_watch import Yard
from tests.server.gap_bench import diagnosing, ended, keep_log
from tests.waiting import wait_for

DRIFTS = "/machines/m001/drifts"


def throw_logged(yard: Yard, count: int, bias_m: float = 0.0) -> None:
    """Throws with logs that hold nothing."""
    yard.throw(count, policy="d", bias_m=bias_m)
    newest = select(Throw.throw_id).order_by(Throw.throw_id.desc()).limit(count)
    with yard.parts.database.read() as database:
        throw_ids = database.scalars(newest).all()
    for throw_id in throw_ids:
        keep_log(yard.parts, "m001", throw_id, b"no log at all" + throw_id.encode())


@pytest.fixture(scope="module")
def yard(running) -> Iterator[Yard]:
    """A machine that has thrown well; afterwards it has never thrown."""
    found = Yard(running)
    found.board("d")
    throw_logged(found, 40)
    yield found
    with running.parts.database.write() as database:
        database.execute(delete(GapRun))
        for table in (Throw, MachinePolicy):
            database.execute(delete(table).where(table.policy_sha256 == "d" * 64))
    for listener in running.parts.throws.on_change:
        listener("m001")


def test_a_drift_is_offered_refused_without_logs_and_diagnosed_against_throws_of_before(
    running, ada, yard
):
    assert ada.get(DRIFTS).json() == []
    assert ada.post(f"{DRIFTS}/2d/gap-runs").json()["error"]["code"] == "no_drift"
    yard.throw(12, bias_m=-0.6, policy="d")
    (drift,) = ada.get(DRIFTS).json()
    assert drift["words"] == "2D throws land shorter than predicted and than before"
    assert drift["throw_count"] >= 12
    assert (
        "since the change have landed with a log; a diagnosis takes at least 6" in drift["problem"]
    )
    reply = ada.post(f"{DRIFTS}/2d/gap-runs")
    assert (reply.status_code, reply.json()["error"]["message"]) == (409, drift["problem"])
    throw_logged(yard, DIAGNOSED_COUNT + 2, bias_m=-0.6)
    (drift,) = ada.get(DRIFTS).json()
    assert (drift["problem"], drift["gap_run_id"]) == ("", None)
    with diagnosing(running.parts, gap_fakes.quick):
        run = ada.post(f"{DRIFTS}/2d/gap-runs").json()
        view = ended(ada, run)
    assert len(view["throw_ids"]) == DIAGNOSED_COUNT
    assert len(view["reference_throw_ids"]) == drift["reference_throw_count"] == 24
    # Throws around the change are in neither.
    order = sorted({*view["throw_ids"], *view["reference_throw_ids"]})
    assert order == [*view["reference_throw_ids"], *view["throw_ids"]]
    assert ada.get(DRIFTS).json()[0]["gap_run_id"] == run["gap_run_id"]
    with running.client("vic") as viewer:
        assert viewer.get(DRIFTS).status_code == 200
        assert viewer.post(f"{DRIFTS}/2d/gap-runs").status_code == 403


def test_where_the_settings_say_so_a_drift_is_diagnosed_once_by_itself(running, ada, yard):
    parts = running.parts
    drifts = parts.drifts._drifts("m001")
    assert drifts
    with parts.database.write() as database:
        database.execute(delete(GapRun))

    def runs() -> list[dict]:
        return ada.get("/machines/m001/gap-runs").json()["rows"]

    with diagnosing(parts, gap_fakes.nothing_found), pytest.MonkeyPatch.context() as patch:
        parts.drifts.start_due("m001", drifts)
        assert runs() == []
        patch.setattr(parts.drifts, "_is_automatic", True)
        few = drifts[0]._replace(since=drifts[0].since[-DIAGNOSED_COUNT + 1 :])
        parts.drifts.start_due("m001", [few])
        assert runs() == []
        # By way of the watch: a throw's news, the test, the diagnosis.
        for listener in parts.throws.on_change:
            listener("m001")
        (run,) = wait_for(runs)
        assert run["created_by"] == SERVER.name
        ended(ada, run)
        parts.drifts.start_due("m001", drifts)
        assert len(runs()) == 1
