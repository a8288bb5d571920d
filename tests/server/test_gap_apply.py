"""Twin profiles from diagnoses: apply, undo, versions, previews before and after."""

import threading

import pytest

from diagnosis.correction import corrected_profile, found_effects
from diagnosis.verdict import Diagnosis, VerdictKind
from machine.errors import UsageError
from machine.spec import load_spec
from server.gap import gap_previews
from server.machines.twin_files import TwinFiles, content_sha256
from sim_twin.twin.profile import load_profile, nominal_profile, save_profile
from tests.server import gap_fakes
from tests.server.gap_bench import GapThread, add_throws
from tests.server.gap_fakes import EXTRA_S, explained
from tests.server.plans.test_planner import NEAR, create, finished
from tests.server.server_bench import wait_for
from tests.server.test_events import Listener

RUNS = "/machines/m001/gap-runs"
TWIN = "/machines/m001/twin-profile"


@pytest.fixture
def eve(running):
    with running.client("eve") as client:
        yield client


@pytest.fixture
def found(running, ada, monkeypatch):
    """Makes runs that explain the gap; m001 has no twin profile before and after."""
    desk = running.parts.gap
    before, desk._process = desk._process, GapThread(gap_fakes.quick)
    monkeypatch.setattr(gap_previews, "ROLLOUT_COUNT", 12)
    throw_ids = add_throws(running.parts, 6)

    def make():
        run = ada.post(RUNS, json={"throw_ids": throw_ids}).json()
        path = f"{RUNS}/{run['gap_run_id']}"
        wait_for(lambda: ada.get(path).json()["row"]["state"] == "done", 150.0)
        return path

    yield make
    desk._process = before
    for path in (running.settings.data_dir / "machines").glob("m001.profile*.json"):
        path.unlink()


def profile_of(running):
    return running.parts.twin_versions._twins.profile("m001")


def test_apply_and_undo_are_versions_of_their_own(running, eve, found):
    start = eve.get(TWIN).json()
    assert (start["version_count"], start["effects"], start["undo_version_count"]) == (0, [], None)
    path = found()
    with Listener(eve) as listener:
        applied = eve.post(f"{path}/apply").json()
        wait_for(lambda: listener.of("twin.updated"))
    first = applied["version_count"]
    assert listener.of("twin.updated")[0]["version_count"] == first
    assert first > 0
    assert applied["undo_version_count"] == 0
    assert applied["effects"] == [
        {
            "effect": "valve_dead_time",
            "joint": "dipper",
            "parameters": {"extra_dead_time_s": EXTRA_S},
        }
    ]
    assert applied["versions"][0]["created_by"] == "eve"
    assert eve.get(path).json()["row"]["applied_version_count"] == first
    on_disk = load_profile(running.settings.data_dir / "machines" / "m001.profile.json")
    assert on_disk.effects == profile_of(running).effects
    assert on_disk.intervals["valve_dead_time.dipper.extra_dead_time_s"] == (0.05, 0.07)
    again = eve.post(f"{path}/apply")
    assert (again.status_code, again.json()["error"]["code"]) == (409, "already_applied")

    second = eve.post(f"{found()}/apply").json()
    assert second["version_count"] == first + 1
    assert len(second["effects"]) == 2
    third = eve.post(f"{TWIN}/undo").json()
    assert (third["version_count"], len(third["effects"])) == (first + 2, 1)
    assert third["undo_version_count"] == 0
    fourth = eve.post(f"{TWIN}/undo").json()
    assert (fourth["version_count"], fourth["effects"]) == (first + 3, [])
    assert fourth["undo_version_count"] is None
    assert content_sha256(profile_of(running)) == content_sha256(nominal_profile(load_spec()))
    assert eve.get(path).json()["row"]["applied_version_count"] is None
    nothing = eve.post(f"{TWIN}/undo")
    assert (nothing.status_code, nothing.json()["error"]["code"]) == (409, "nothing_to_undo")
    # The same content is in use again, so the same run may be applied again.
    assert eve.post(f"{path}/apply").json()["version_count"] == first + 4
    with running.client("root") as root:
        rows = root.get("/audit", params={"machine_id": "m001"}).json()["rows"]
        assert root.get("/audit/verify").json()["is_intact"]
    actions = [r["action"] for r in rows if r["action"].startswith("twin.")]
    assert actions[:5].count("twin.apply") == 3
    assert actions[:5].count("twin.undo") == 2


def test_previews_use_the_new_profile_at_once(running, machine, ada, eve, found):
    path = found()
    before = finished(ada, create(ada))
    near = {"mode": "2d", **{k: NEAR[k] for k in ("range_m", "azimuth_rad")}}
    compared = ada.get(f"{path}/preview", params=near).json()
    assert compared["is_machine_pose"]
    same, other = compared["before"]["prediction"], compared["after"]["prediction"]
    assert same["impact_m"] == pytest.approx(before["prediction"]["impact_m"], abs=1e-6)
    assert other["impact_m"] != pytest.approx(same["impact_m"], abs=1e-3)
    assert same["ellipse"]["rollout_count"] > 0
    version = eve.post(f"{path}/apply").json()["version_count"]
    after = finished(ada, create(ada))
    assert after["twin_profile_version"] == version
    assert after["prediction"]["impact_m"] == pytest.approx(other["impact_m"], abs=1e-6)
    # While it is in use, the two can still be compared: what it was applied to, and what is in use.
    again = ada.get(f"{path}/preview", params=near).json()
    assert (again["before"]["version_count"], again["after"]["version_count"]) == (0, version)
    for side in ("before", "after"):
        for key in ("impact_m", "ellipse"):
            assert again[side]["prediction"][key] == compared[side]["prediction"][key]


def test_the_comparison_throws_with_the_version_on_board(running, machine, ada, found, monkeypatch):
    def active(mode):
        raise AssertionError(f"the machine has a version for {mode}")

    monkeypatch.setattr(running.parts.policies, "active", active)
    compared = ada.get(f"{found()}/preview", params={"mode": "2d", "range_m": 6.03}).json()
    assert compared["is_machine_pose"]
    assert compared["before"]["prediction"] is not None


def test_few_comparisons_are_previewed_at_once(running, ada, found, monkeypatch):
    path = found()
    monkeypatch.setattr(running.parts.gap_previews, "_places", threading.BoundedSemaphore(1))
    with running.parts.gap_previews._places:
        busy = ada.get(f"{path}/preview", params={"mode": "2d", "range_m": 6.03})
    assert (busy.status_code, busy.json()["error"]["code"]) == (429, "previews_busy")
    assert ada.get(f"{path}/preview", params={"mode": "2d", "range_m": 6.03}).status_code == 200


def test_a_lost_machine_is_compared_from_the_pose_for_throwing(running, ada, found):
    wait_for(lambda: not running.parts.registry.is_connected("m001"))
    path = found()
    compared = ada.get(f"{path}/preview", params={"mode": "2d", "range_m": 6.03}).json()
    assert not compared["is_machine_pose"]
    assert compared["after"]["prediction"] is not None
    far = ada.get(f"{path}/preview", params={"mode": "2d", "range_m": 40.0})
    assert (far.status_code, far.json()["error"]["code"]) == (409, "target_out_of_reach")
    assert not list((running.settings.data_dir / "gap").iterdir())


def test_a_profile_that_changed_since_is_not_corrected(running, eve, found):
    first, second = found(), found()
    assert eve.post(f"{first}/apply").status_code == 200
    stale = eve.post(f"{second}/apply")
    assert (stale.status_code, stale.json()["error"]["code"]) == (409, "profile_changed")
    # A file that somebody measured anew is no version of ours: nothing to undo, but numbers go on.
    path = running.settings.data_dir / "machines" / "m001.profile.json"
    version = load_profile(path).version_count
    measured = nominal_profile(load_spec()).model_copy(
        update={"version_count": version, "gain_ratio": (1.1, 1.0, 1.0, 1.0)}
    )
    save_profile(measured, path)
    assert eve.get(TWIN).json()["undo_version_count"] is None
    applied = eve.post(f"{found()}/apply").json()
    assert applied["version_count"] == version + 1
    assert profile_of(running).gain_ratio[0] == 1.1
    eve.post(f"{TWIN}/undo")
    assert profile_of(running).gain_ratio[0] == 1.1
    assert profile_of(running).effects == ()


def test_only_engineers_change_the_twin(running, ada, eve, found):
    path = found()
    for name in ("vic", "ada", "sue"):
        with running.client(name) as client:
            assert client.post(f"{path}/apply").status_code == 403
            assert client.post(f"{TWIN}/undo").status_code == 403
    assert ada.get(TWIN).status_code == 200
    assert eve.get("/machines/m009/twin-profile").status_code == 404


def test_a_run_without_effects_cannot_be_applied(running, ada, eve, found):
    running.parts.gap._process = GapThread(gap_fakes.nothing_found)
    path = found()
    for reply in (
        eve.post(f"{path}/apply"),
        ada.get(f"{path}/preview", params={"mode": "2d", "range_m": 6.0}),
    ):
        assert (reply.status_code, reply.json()["error"]["code"]) == (409, "nothing_to_apply")


def test_only_an_explained_diagnosis_corrects_a_profile():
    profile = nominal_profile(load_spec())
    ambiguous = explained().model_copy(update={"verdict": VerdictKind.AMBIGUOUS})
    assert found_effects(ambiguous) == ()
    with pytest.raises(ValueError, match="no effect to add"):
        corrected_profile(profile, Diagnosis(verdict=VerdictKind.NONE), "m001", "")
    with pytest.raises(ValueError, match="outside"):
        corrected_profile(profile, explained(5.0), "m001", "")


def test_twin_files_keep_what_they_replace(tmp_path):
    files = TwinFiles(tmp_path)
    profile = nominal_profile(load_spec()).model_copy(update={"version_count": 1})
    kept = files.replace("m001", profile)
    assert files.profile("m001") == profile
    assert files.kept(kept).version_count == 0
    assert files.profile_version("m001") == 1
    with pytest.raises(UsageError, match="backup"):
        files.kept("../../m001.profile.v9.json")
    assert not list(tmp_path.rglob("*.part"))
