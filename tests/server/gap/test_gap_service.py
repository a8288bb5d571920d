"""Diagnoses in the server: queue, process, progress, cancel, restart, report, rights.

From recorded throws to a verdict, in the real process: tests/e2e/test_gap.py.
"""

import os

import pytest

from machine.conventions import Mode
from machine.errors import LogError
from machine.spec import load_spec
from server import child_process
from server.child_process import NICENESS
from server.gap import gap_worker
from server.gap.gap_worker import GapProcess
from server.job_queue import WAITING_COUNT
from server.schemas.console import Role
from server.schemas.gap import GapState
from sim_twin.twin.profile import nominal_profile
from tests.cases import each
from tests.server import gap_fakes
from tests.server.gap_bench import (
    RUNS,
    GapThread,
    add_throws,
    diagnosing,
    ended,
    forget_throws,
    start,
)
from tests.server.server_bench import PASSWORD, make_settings, running_server
from tests.server.test_events import Listener
from tests.waiting import is_alive, wait_for


@pytest.fixture(scope="module")
def throws(running):
    """Eight throws of m001, the last two in 2D; and some that cannot be used."""
    parts = running.parts
    forget_throws(parts)
    used = add_throws(parts, 6) + add_throws(parts, 2, mode=Mode.PLANAR)
    add_throws(parts, 1, has_log=False)
    add_throws(parts, 1, outcome="aborted")
    add_throws(parts, 1, machine_id="m002")
    return used


def test_a_run_gives_result_report_events_and_audit(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.quick), Listener(ada) as listener:
        run = start(ada, newest_count=7, material_m=0.05)
        assert run["state"] in ("queued", "running") and run["throw_count"] == 7
        view = ended(ada, run)
        wait_for(lambda: listener.of("gap.updated")[-1:])
        wait_for(lambda: listener.of("gap.updated")[-1]["run"]["state"] == "done")
    seen = [event["run"] for event in listener.of("gap.updated")]
    assert seen[0]["state"] in ("queued", "running")
    assert any(r["step"] == "half way" and r["progress_ratio"] == 0.5 for r in seen)
    assert view["throw_ids"] == throws[1:]
    row = view["row"]
    assert (row["state"], row["verdict"], row["effect_count"]) == ("done", "explained", 1)
    assert row["sentence"] == "The dipper is late by 60 ms."
    assert row["progress_ratio"] == 1.0
    assert view["result"]["evidence"]["logs"] == 7
    assert view["result"]["evidence"]["missing"] is None
    assert view["result"]["evidence"]["material_m"] == 0.05
    assert row["compared_with"] == "healthy machines of the type"
    (first, *_) = view["words"]["causes"]
    assert (first["title"], first["probability"]) == ("valve dead time, dipper", "95 %")
    page = ada.get(f"{RUNS}/{row['gap_run_id']}/report.html")
    assert page.headers["content-type"].startswith("text/html")
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "sandbox" in policy
    assert "script-src" not in policy
    assert "<script>" not in page.text
    assert "The dipper is late by 60 ms." in page.text
    assert ada.get(RUNS).json()["rows"][0]["gap_run_id"] == row["gap_run_id"]
    with running.client("root") as root:
        rows = root.get("/audit", params={"machine_id": "m001"}).json()["rows"]
    assert {"gap.run", "gap.done"} <= {r["action"] for r in rows}


def test_an_open_run_says_what_earlier_ones_like_it_took(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.quick):
        ended(ada, start(ada, throw_ids=throws[:6]))
        asked = start(ada, throw_ids=throws[:6])
        low_s, high_s = asked["usual_s"]
        assert 0.0 <= low_s <= high_s
        assert ended(ada, asked)["row"]["usual_s"] is None


def test_throws_by_name_or_the_newest_of_a_mode(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.nothing_found):
        chosen = throws[:6]
        view = ended(ada, start(ada, throw_ids=list(reversed(chosen))))
        assert view["throw_ids"] == chosen
        assert view["row"]["verdict"] == "none"
        assert view["row"]["effect_count"] == 0
        view = ended(ada, start(ada, newest_count=6, mode="3d"))
        assert view["throw_ids"] == throws[:6]


@each(
    ("body", "status", "text"),
    [
        ({}, 422, "either throw_ids or newest_count"),
        ({"newest_count": 5}, 422, "greater than or equal to 6"),
        ({"throw_ids": ["a"] * 6}, 422, "named twice"),
        ({"throw_ids": [f"t{i}" for i in range(6)]}, 409, "6 of 6 throws"),
        ({"newest_count": 12, "mode": "2d"}, 409, "m001 has 2 landed throws with a log in 2d"),
        ({"throw_ids": [f"t{i}" for i in range(6)], "mode": "2d"}, 422, "mode goes with"),
    ],
)
def test_requests_that_cannot_be_met_say_why(ada, throws, body, status, text):
    reply = ada.post(RUNS, json=body)
    assert reply.status_code == status
    assert text in reply.json()["error"]["message"]


def test_other_machines_and_runs_are_not_found(running, ada, throws):
    body = {"newest_count": 6}
    assert ada.post("/machines/m009/gap-runs", json=body).status_code == 404
    assert ada.get("/machines/m009/gap-runs").status_code == 404
    with diagnosing(running.parts, gap_fakes.nothing_found):
        run = ended(ada, start(ada))["row"]
    other = f"/machines/m002/gap-runs/{run['gap_run_id']}"
    assert ada.get(other).status_code == 404
    assert ada.get(f"{other}/report.html").status_code == 404
    assert ada.delete(other).status_code == 404


def test_one_at_a_time_at_low_priority_and_cancel_kills(running, ada, throws, monkeypatch):
    monkeypatch.setattr(child_process, "NICENESS", NICENESS)
    with diagnosing(running.parts, gap_fakes.patient, GapProcess):
        first, second = start(ada), start(ada)
        wait_for(
            lambda: ada.get(f"{RUNS}/{first['gap_run_id']}").json()["row"]["progress_ratio"] == 0.25
        )
        assert ada.get(f"{RUNS}/{second['gap_run_id']}").json()["row"]["state"] == "queued"
        path = running.parts.logs.path(throws[-6]).parent / "gap.pid"
        *pids, nice = (int(part) for part in path.read_text().split())
        assert nice >= min(os.nice(0) + 10, 19)
        assert ada.delete(f"{RUNS}/{second['gap_run_id']}").json()["state"] == "cancelled"
        assert ada.delete(f"{RUNS}/{first['gap_run_id']}").status_code == 200
        view = ended(ada, first)
        assert view["row"]["state"] == "cancelled"
        assert view["result"] is None
        wait_for(lambda: not any(is_alive(pid) for pid in pids))
        again = ada.delete(f"{RUNS}/{first['gap_run_id']}")
        assert (again.status_code, again.json()["error"]["code"]) == (409, "gap_run_ended")
        report = ada.get(f"{RUNS}/{first['gap_run_id']}/report.html")
        assert (report.status_code, report.json()["error"]["code"]) == (409, "no_report")


def test_a_full_queue_is_refused(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.patient, GapProcess) as desk:
        start(ada)
        wait_for(lambda: not desk.queue._waiting)
        for _ in range(WAITING_COUNT):
            start(ada)
        reply = ada.post(RUNS, json={"newest_count": 6})
        assert (reply.status_code, reply.json()["error"]["code"]) == (429, "gap_queue_full")


@each(
    ("diagnose", "runner", "text"),
    [
        (gap_fakes.dying, GapProcess, "exit code 7"),
        (gap_fakes.mistaken, GapThread, "KeyError"),
        (gap_fakes.infinite, GapThread, "share_ratio"),
    ],
)
def test_a_diagnosis_that_fails_says_so_and_the_next_one_runs(
    running, ada, throws, diagnose, runner, text
):
    with diagnosing(running.parts, diagnose, runner):
        row = ended(ada, start(ada))["row"]
        assert row["state"] == "failed"
        assert text in row["detail"]
    with diagnosing(running.parts, gap_fakes.nothing_found):
        assert ended(ada, start(ada))["row"]["state"] == "done"


def test_damaged_logs_are_bad_data_not_a_failure(ada, throws):
    """The real diagnosis in the real process."""
    view = ended(ada, start(ada))
    assert view["row"]["verdict"] == "bad_data"
    refused = view["result"]["evidence"]["refused"]
    assert len(refused) == 6
    # Named by the throw, not by the path of the file.
    for entry in refused:
        assert entry["path"].startswith("throw of 20")
        assert entry["reason"].startswith("it is not a readable throw log")
        assert ".mcap" not in entry["reason"]
    assert ".mcap" not in view["row"]["sentence"]


def test_rights(running, ada, throws):
    with running.client("vic") as vic, diagnosing(running.parts, gap_fakes.nothing_found):
        assert vic.post(RUNS, json={"newest_count": 6}).status_code == 403
        assert vic.get(RUNS).status_code == 200
        run_id = ended(ada, start(ada))["row"]["gap_run_id"]
        assert vic.delete(f"{RUNS}/{run_id}").status_code == 403
        assert vic.get(f"{RUNS}/{run_id}").status_code == 200
    with running.client() as nobody:
        assert nobody.get(RUNS).status_code == 401
        assert nobody.get(f"{RUNS}/{run_id}/report.html").status_code == 401


def test_pages_of_runs(running, ada, throws):
    with diagnosing(running.parts, gap_fakes.nothing_found):
        for run in [start(ada) for _ in range(4)]:
            ended(ada, run)
    rows = ada.get(RUNS, params={"limit": 200}).json()["rows"]
    assert len(rows) >= 4
    first = ada.get(RUNS, params={"limit": 2}).json()
    second = ada.get(RUNS, params={"limit": 2, "cursor": first["next_cursor"]}).json()
    assert [r["gap_run_id"] for r in first["rows"] + second["rows"]] == [
        r["gap_run_id"] for r in rows[:4]
    ]


def test_open_runs_are_interrupted_by_a_restart(tmp_path, swing_policies):
    settings = make_settings(tmp_path / "data", swing_policies)
    with running_server(settings) as first:
        add_throws(first.parts, 6)
        first.parts.gap._process = GapProcess(gap_fakes.patient)
        first.parts.accounts.create_user("tim", PASSWORD, Role.OPERATOR)
        with first.client("tim") as tim:
            runs = [start(tim), start(tim)]
            path = f"{RUNS}/{runs[0]['gap_run_id']}"
            wait_for(lambda: tim.get(path).json()["row"]["progress_ratio"] == 0.25)
        folder = first.parts.logs.path(
            first.parts.gap.store.row(runs[0]["gap_run_id"]).throw_ids[0]
        ).parent
        *pids, _ = (int(part) for part in (folder / "gap.pid").read_text().split())
    wait_for(lambda: not any(is_alive(pid) for pid in pids))
    with running_server(settings) as second, second.client("tim") as tim:
        for run in runs:
            row = tim.get(f"{RUNS}/{run['gap_run_id']}").json()["row"]
            assert row["state"] == GapState.INTERRUPTED
            assert "Start it again" in row["detail"]


def test_logs_are_read_within_limits_of_memory_and_time(tmp_path, monkeypatch):
    asked, closed = [], []

    class Reader:
        def __init__(self, read_s):
            assert read_s == gap_worker.READ_S

        def read(self, path):
            asked.append(path.name)
            raise LogError(f"{path} took more than 2 GiB to read")

        def close(self):
            closed.append(True)

    monkeypatch.setattr(gap_worker, "LimitedLogReader", Reader)
    paths = [tmp_path / f"{number}.mcap" for number in range(3)]
    for path in paths:
        path.write_bytes(b"a bomb")
    job = gap_worker.GapJob(
        "m001", tuple(paths[:2]), nominal_profile(load_spec()), (paths[2],), {"0.mcap": "throw 0"}
    )
    found = gap_worker.diagnose_logs(job, lambda *_: None)
    assert "throw 0: it took more than 2 GiB" in found.sentence
    assert (asked, closed) == (["0.mcap", "1.mcap", "2.mcap"], [True])
