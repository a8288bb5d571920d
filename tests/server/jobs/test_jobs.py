"""Bulk jobs in a server: proposed, thrown, followed, undone, surveyed; two writers; a restart goes on."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bulk.job_file import JobFile, material_of
from bulk.placement import LandedLoad
from bulk.throw_model import LandingScatter, PolicyFolder, measured_model
from machine.conventions import Mode
from machine.messages import Target
from machine.policy_card import load_card
from machine.site.objects import SiteObject
from machine.site.thrown_material import MaterialFootprint
from machine.site.zones import Zone
from machine.spec import load_spec
from server.child_process import ChildFailedError, ChildKilledError
from server.clock import new_id, utc_now
from server.errors import ApiError, ConflictError, InfeasibleError, NotFoundError
from server.jobs.job_ground import JobGround, NumberedLoad, SurveyedSurface
from server.jobs.job_planning import PlanTask, plan_in_child, planned_loads
from server.jobs.job_views import (
    JobChange,
    JobEndRequest,
    JobLoadRequest,
    JobMoveRequest,
    JobRequest,
    JobSkipRequest,
    JobSurveyRequest,
)
from server.jobs.jobs import Jobs
from server.jobs.throw_loads import SCATTER_COUNT, scatter_by_range
from server.schemas.sites import SiteRequest
from server.store.models import Audit, Throw
from server.throws.impacts import add_impact
from sim_twin.throws.landing import SiteLanding
from tests.waiting import wait_for

BED = {"x_m": 8.0, "y_m": 0.0, "length_m": 2.0, "width_m": 1.6}
FILE = {
    "name": "truck 7",
    "mode": "2d",
    "pace_ratio": 0.0,
    "material": "gravel",
    "grab_m3": 0.2,
    "area": {"x_min_m": 6.0, "x_max_m": 10.0, "y_min_m": -2.0, "y_max_m": 2.0},
    "containers": [{"name": "bed", **BED, "floor_m": 0.3, "wall_m": 0.4}],
    "work": {"kind": "truck", "container": "bed"},
}
BOX = SiteObject(name="truck", kind="box", height_m=0.3, **BED)


def quick_plan(task, _is_cancelled):
    scatter, stuff = [LandingScatter(8.0, 0.05, 0.05)], material_of(task.file)
    models = [
        measured_model(one.card, load_spec(), stuff, scatter, 0.5, task.file.grab_m3)
        for one in task.policies
    ]
    return planned_loads(replace(task, models=task.models or tuple(models)))


class Yard:
    """Jobs of machine m001, with a truck on its site."""

    def __init__(self, assembled):
        self.parts, self.ada = assembled.parts, assembled.session()
        self.parts.registry.get("m001").is_listed = True
        self.parts.sites.change("m001", SiteRequest(from_version_count=0, objects=(BOX,)), self.ada)
        self.jobs = self.restarted()

    def restarted(self):
        parts = self.parts
        self.jobs = Jobs(
            parts.database, parts.audit, parts.registry, parts.policies, parts.sites, parts.zones,
            parts.hub, load_spec(), quick_plan,
        )  # fmt: skip
        self.jobs.start()
        parts.sites.surface_at = self.jobs.surface_at
        return self.jobs

    def create(self, survey_csv=None, **changes):
        file = JobFile.model_validate(FILE | changes)
        body = JobRequest(machine_id="m001", file=file, survey_csv=survey_csv)
        return self.planned(self.jobs.create(body, self.ada).job_id)

    def planned(self, job_id):
        wait_for(lambda: self.jobs.view(job_id).plan_state != "planning")
        return self.jobs.view(job_id)

    def throw(self, target, *, machine_id="m001", outcome="landed", at_utc=None):
        throw_id = new_id()
        with self.parts.database.write() as database:
            database.add(
                Throw(
                    throw_id=throw_id, machine_id=machine_id, plan_id="p", session_id="s",
                    created_utc=at_utc or utc_now(), operator="ada", epoch_count=1, mode="2d",
                    target_x_m=target[0], target_y_m=target[1], target_z_m=0.3,
                    range_m=float(np.hypot(*target)), policy_id="p", policy_sha256="0" * 64,
                    phase="ended", outcome=outcome, predicted_downrange_error_m=0.02,
                    predicted_crossrange_error_m=-0.01,
                )
            )  # fmt: skip
        self.jobs.take_throws(machine_id)
        return throw_id

    def survey(self, view, z_m, *, x_m=(6.0, 10.0)):
        x = np.arange(x_m[0], x_m[1] + 1e-6, 0.1)
        lines = [f"{a:.2f},{b:.2f},{z_m}" for b in np.arange(-2.0, 2.01, 0.1) for a in x]
        text = "\n".join(["x_m,y_m,z_m", *lines])
        body = JobSurveyRequest(version_count=view.version_count, survey_csv=text)
        return self.jobs.survey(view.job_id, body, self.ada)

    def enter(self, view, x_m=8.0, y_m=0.0, volume_m3=0.2):
        body = JobLoadRequest(
            version_count=view.version_count, x_m=x_m, y_m=y_m, volume_m3=volume_m3
        )
        return self.jobs.add_load(view.job_id, body, self.ada)


@pytest.fixture
def yard(assembled):
    found = Yard(assembled)
    yield found
    found.jobs.close()


def change(view):
    return JobChange(version_count=view.version_count)


def test_a_throw_at_a_proposal_is_a_load_and_follows_its_impact_until_it_is_undone(yard):
    begun = yard.create()
    assert begun.plan_state == "ready" and begun.landing_by == "predicted"
    first = begun.next[0]
    assert first.z_m == first.surface_m == pytest.approx(0.3)
    assert "missing" in first.sentence
    yard.throw((first.x_m + 0.3, first.y_m), machine_id="m001")
    yard.throw((first.x_m, first.y_m), outcome="stopped")
    yard.throw((first.x_m, first.y_m), at_utc=begun.created_utc)  # before it was offered
    assert yard.jobs.view(begun.job_id).loads == (), "none is a load of the job"
    throw_id = yard.throw((first.x_m + 0.03, first.y_m))
    thrown = yard.planned(begun.job_id)
    (load,) = thrown.loads
    assert (load.throw_id, load.landed_by, load.recorded_by) == (throw_id, "predicted", "server")
    assert load.volume_m3 == first.volume_m3
    assert thrown.progress.filled_ratio > begun.progress.filled_ratio
    assert any(item.surface_m > 0.4 for item in thrown.next)
    assert all(item.z_m == item.surface_m for item in thrown.next), "of what lies on the truck"
    sites, target = yard.parts.sites, Target(x_m=first.x_m, y_m=first.y_m, z_m=0.3)
    (risen,) = sites.around("m001", target)
    surface_m = yard.jobs.surface_at("m001", first.x_m, first.y_m)
    assert risen.height_m == pytest.approx(surface_m, abs=0.006) and surface_m > 0.4
    sites.require_unchanged("m001", target, (risen,))
    with pytest.raises(ApiError, match="changed since the preview"):
        sites.require_unchanged("m001", target, (BOX,))
    assert SiteLanding.of((risen,), target).target_refusal(target).surface_m == risen.height_m
    yard.parts.sites.change("m001", SiteRequest(from_version_count=1, objects=()), yard.ada)
    yard.jobs.note_surroundings("m001")
    wait_for(
        lambda: (
            (shown := yard.jobs.view(begun.job_id).next)
            and all(item.z_m == item.surface_m for item in shown)
        )
    )
    with yard.parts.database.write() as database:
        throw = database.get(Throw, throw_id)
        add_impact(database, throw, (8.4, 0.3, 0.3), "manual", sd_m=None, recorded_by="ada")
    yard.jobs.take_throws("m001")
    yard.jobs.take_throws("m001")
    followed = yard.planned(begun.job_id)
    (load,) = followed.loads
    assert (load.x_m, load.y_m, load.landed_by) == (
        pytest.approx(8.4), pytest.approx(0.3), "measured",
    )  # fmt: skip
    assert followed.version_count == thrown.version_count + 1, "what is known already is no change"
    laid = yard.jobs.material("m001")
    first_next = laid.next_loads[0]
    assert len(first_next.faces) > 10 and first_next.text == "1: 0.20 m³"
    assert len(laid.faces) > 10 and len(laid.contours_m) > 4
    middle = laid.vertices_m.mean(axis=0)
    assert np.hypot(middle[0] - 8.4, middle[1] - 0.3) < 0.5, "drawn where it fell"
    assert laid.vertices_m[:, 2].max() < 0.7, "no wall belongs to it"
    undone = yard.jobs.undo(begun.job_id, change(followed), yard.ada)
    assert len(yard.jobs.material("m001").faces) == 0
    yard.jobs.take_throws("m001")
    assert undone.progress == begun.progress and undone.loads[0].is_withdrawn
    again = yard.planned(begun.job_id)
    assert again.version_count == undone.version_count, "a withdrawn throw is not recorded again"
    body = JobLoadRequest(version_count=again.version_count, throw_id=throw_id)
    assert yard.jobs.add_load(begun.job_id, body, yard.ada).load_count == 1, "but by a person"


def test_a_load_lies_as_it_was_measured(yard):
    begun = yard.create()
    first = begun.next[0]
    wanted = yard.jobs.thrown_material("m001", Target(x_m=first.x_m, y_m=first.y_m + 0.03))
    assert (wanted.name, wanted.volume_m3, wanted.mass_kg) == ("gravel", 0.2, pytest.approx(304.0))
    assert yard.jobs.thrown_material("m001", Target(x_m=first.x_m + 0.3, y_m=first.y_m)) is None
    assert yard.jobs.thrown_material("m002", Target(x_m=first.x_m, y_m=first.y_m)) is None
    throw_id = yard.throw((first.x_m, first.y_m))
    predicted = yard.planned(begun.job_id)
    assert predicted.loads[0].spread_m is None
    lies = MaterialFootprint(volume_m3=0.17, covariance_m2=(0.04, 0.0, 0.09))
    with yard.parts.database.write() as database:
        throw = database.get(Throw, throw_id)
        add_impact(
            database,
            throw,
            (8.0, 0.2, 0.3),
            "survey",
            sd_m=0.02,
            recorded_by="m001",
            footprint=lies,
        )
    yard.jobs.take_throws("m001")
    (load,) = yard.planned(begun.job_id).loads
    assert (load.volume_m3, load.landed_by) == (0.17, "measured")
    assert load.spread_m == pytest.approx((0.3, 0.2))
    surface = yard.jobs.surface(begun.job_id)
    rise = np.array(surface.height_m) - np.array(surface.start_m)
    assert rise.sum() * 0.01 == pytest.approx(0.17, rel=0.01), "what fell, not what was planned"
    assert "spread 0.30 m by 0.20 m" in yard.jobs.report(begun.job_id)


def test_a_skipped_place_is_left_out_until_the_next_load_and_a_moved_one_is_checked(yard):
    begun = yard.create()
    first = begun.next[0]
    body = JobSkipRequest(version_count=begun.version_count, proposal_count=1)
    skipped = yard.jobs.skip(begun.job_id, body, yard.ada)
    skipped = yard.planned(begun.job_id)
    away = [np.hypot(p.x_m - first.x_m, p.y_m - first.y_m) for p in skipped.next]
    assert len(away) == 3 and min(away) > 0.4
    with pytest.raises(ConflictError, match="version 2 now, you changed version 1"):
        yard.jobs.skip(begun.job_id, body, yard.ada)
    place = {"version_count": skipped.version_count, "proposal_count": 2}
    with pytest.raises(InfeasibleError, match="beside the truck"):
        yard.jobs.move(begun.job_id, JobMoveRequest(**place, x_m=9.6, y_m=0.0), yard.ada)
    moved = yard.jobs.move(begun.job_id, JobMoveRequest(**place, x_m=8.55, y_m=0.3), yard.ada)
    assert (moved.next[1].x_m, moved.next[0]) == (8.55, skipped.next[0])
    assert "x 8.6 m" in moved.next[1].sentence or "x 8.5 m" in moved.next[1].sentence
    yard.throw((8.55, 0.3))
    assert yard.jobs.view(begun.job_id).load_count == 1
    with yard.parts.database.read() as database:
        actions = {row.action for row in database.query(Audit)}
    assert {"job.create", "job.skip", "job.move", "job.load"} <= actions


def test_what_cannot_be_done_is_refused_with_its_reason(yard):
    far = [FILE["containers"][0] | {"floor_m": 2.5}]
    with pytest.raises(InfeasibleError, match=r"heights of -0\.8 to 0\.8 m"):
        yard.create(containers=far)
    with pytest.raises(InfeasibleError, match="at most 40000"):
        yard.create(cell_m=0.02)
    with pytest.raises(InfeasibleError, match="survey is empty") as refused:
        yard.create("", survey="ground.csv", area=None)
    assert refused.value.detail["problems"][0]["field"] == "survey"
    begun = yard.create()
    with pytest.raises(ConflictError, match="Job truck 7 of m001 is open"):
        yard.create()
    with pytest.raises(InfeasibleError, match=r"leaves out \d+ of \d+ cells"):
        yard.survey(begun, 0.3, x_m=(6.0, 7.5))
    with pytest.raises(InfeasibleError, match=r"1\.30 m or more below"):
        yard.survey(begun, -1.0)
    with pytest.raises(InfeasibleError, match="beside the ground"):
        yard.enter(begun, x_m=20.0)
    with pytest.raises(ConflictError, match="no load to withdraw"):
        yard.jobs.undo(begun.job_id, change(begun), yard.ada)
    with pytest.raises(NotFoundError):
        body = JobLoadRequest(version_count=1, throw_id="nope")
        yard.jobs.add_load(begun.job_id, body, yard.ada)
    ended = yard.jobs.end(begun.job_id, JobEndRequest(version_count=1, reason="rain"), yard.ada)
    assert (ended.status, ended.ended_by, ended.next) == ("ended", "ada", ())
    assert yard.jobs.material("m001") is None
    with pytest.raises(ConflictError, match="has ended"):
        yard.enter(ended)
    assert yard.create(name="truck 8").name == "truck 8"
    page = yard.jobs.page("m001", "ended", None, 1)
    assert [item.name for item in page.items] == ["truck 7"]
    assert page.next_cursor is None


def test_of_two_writers_with_one_version_one_is_refused(yard):
    begun, answers = yard.create(), []

    def write():
        try:
            answers.append(yard.enter(begun).version_count)
        except ConflictError as error:
            answers.append(error.code)

    threads = [threading.Thread(target=write) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(map(str, answers)) == ["2", "job_changed"]
    assert yard.jobs.view(begun.job_id).load_count == 1


def test_a_restart_goes_on_with_the_same_surface_and_a_survey_replaces_it(yard):
    begun = yard.create()
    view = yard.enter(yard.enter(begun), x_m=7.6)
    before = yard.jobs.surface(begun.job_id)
    yard.jobs.close()
    jobs = yard.restarted()
    assert jobs.surface(begun.job_id) == before
    assert yard.planned(begun.job_id).plan_state == "ready"
    surveyed = yard.survey(view, 0.5)
    surface = np.array(jobs.surface(begun.job_id).height_m)
    region = np.array(before.region)
    assert (surface[region] == 0.5).all()
    assert surveyed.thrown_m3 == pytest.approx(0.4)
    with pytest.raises(ConflictError, match="before the last survey"):
        jobs.undo(begun.job_id, change(surveyed), yard.ada)
    last = yard.planned(yard.enter(surveyed).job_id)
    full = yard.survey(last, 0.7)
    assert yard.planned(full.job_id).plan_state == "nothing_left"
    page = jobs.report(begun.job_id)
    assert "Job truck 7<" in page and page.count("<svg") == 4 and "entered at x 7.60 m" in page


STEPS = st.lists(
    st.one_of(
        st.tuples(
            st.just("load"), st.floats(5.5, 10.5), st.floats(-2.5, 2.5), st.floats(0.01, 0.5)
        ),
        st.tuples(st.just("undo")),
        st.tuples(st.just("survey"), st.floats(0.0, 0.6)),
    ),
    max_size=10,
)


@given(STEPS)
@settings(max_examples=25, deadline=None)
def test_volume_closes_over_loads_undo_and_surveys_and_a_replay_is_the_same(steps):
    file = JobFile.model_validate(FILE | {"cell_m": 0.2})
    ground = JobGround(file, None, load_spec())
    surveyed, loads, base_m3 = None, [], 0.0
    for number, step in enumerate(steps, start=1):
        if step[0] == "load":
            loads.append(NumberedLoad(number, LandedLoad(*step[1:])))
        elif step[0] == "undo":
            loads = loads[:-1]
        else:
            height = np.full_like(ground.job.field.height_m, step[1])
            surveyed, loads = SurveyedSurface(number, height), []
            base_m3 = ground.surfaces(surveyed, ())[0].field.volume_m3()
        surface, after = ground.surfaces(surveyed, loads)
        thrown_m3 = sum(load.load.volume_m3 for load in loads)
        assert surface.field.volume_m3() == pytest.approx(base_m3 + thrown_m3, rel=1e-3, abs=1e-9)
        assert set(after) == {load.number for load in loads}
    fresh, _ = JobGround(file, None, load_spec()).surfaces(surveyed, loads)
    kept, _ = ground.surfaces(surveyed, loads)
    assert (fresh.field.height_m == kept.field.height_m).all()


def test_scatter_is_measured_from_enough_throws_of_about_one_range():
    rng = np.random.default_rng(1)
    near, far = (
        np.column_stack([
            rng.uniform(low, low + 2.0, count), rng.normal(0.3, sd, count), rng.normal(0.0, 0.05, count),
        ])
        for low, sd, count in ((6.0, 0.05, 200), (9.0, 0.3, 200))
    )  # fmt: skip
    assert scatter_by_range(near[: SCATTER_COUNT - 1]) == ()
    found = scatter_by_range(np.concatenate([far, near]))
    ranges = [item.range_m for item in found]
    assert ranges == sorted(set(ranges))
    assert found[0].sd_downrange_m == pytest.approx(0.05, rel=0.5)
    assert found[-1].sd_downrange_m == pytest.approx(0.3, rel=0.5)


def test_a_process_of_its_own_plans_alike_and_says_what_cannot_be_done():
    folder = Path(__file__).parents[3] / "policies" / "m545-2d-v7"
    file = JobFile.model_validate(FILE)
    corners_m = ((4.0, -1.0), (5.0, -1.0), (5.0, 1.0), (4.0, 1.0))
    zone = Zone(name="path", reason="people walk there", corners_m=corners_m, top_m=3.0)
    task = PlanTask(
        file=file,
        ground=None,
        height_m=JobGround(file, None, load_spec()).job.field.height_m,
        passed_m=((8.0, 0.0),),
        zones=(),
        policies=(PolicyFolder(folder, load_card(folder)),),
        landing={Mode.PLANAR: (LandingScatter(8.0, 0.05, 0.05),)},
        loads={},
        models=None,
    )
    assert plan_in_child(task, lambda: False).loads == planned_loads(task).loads
    with pytest.raises(
        ChildFailedError, match="every place of the truck lies in an exclusion zone"
    ):
        plan_in_child(replace(task, zones=(zone,)), lambda: False)
    with pytest.raises(ChildKilledError):
        plan_in_child(task, lambda: True)
