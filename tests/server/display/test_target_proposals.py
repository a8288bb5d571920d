"""Rings follow the height of what is aimed at, and are drawn anew only where they change."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from machine.conventions import Mode
from machine.messages import Target
from machine.reach import reach_m
from machine.site.zones import ZoneSet
from machine.spec import load_spec
from server.display.target_proposals import TargetProposals
from server.schemas.console import ModeReach, ReachView, ViewRequest
from server.viewer.state import Reach

CARD = SimpleNamespace(
    mode=Mode.PLANAR,
    target_range_max_m=10.9,
    reach_at_height_m=((-1.0, 10.9), (0.0, 10.9), (2.0, 9.0)),
)


class Shelf:
    """2D alone, which knows heights; version "short" reaches 8 m."""

    def reach(self, aboard: Mapping[str, str]) -> ReachView:
        far_m = 8.0 if aboard.get("2d") == "short" else 10.9
        known = ModeReach(
            mode=Mode.PLANAR, policy_id="p", policy_sha256="0" * 64, range_min_m=5.5,
            range_max_m=far_m, raised_range_max_m=9.0, height_min_m=-1.0, height_max_m=2.0,
            has_pace=False,
        )  # fmt: skip
        return ReachView(static_reach_m=7.5, modes=(known,))

    def farthest_m(self, aboard: Mapping[str, str], modes: list[Mode], height_m: float) -> float:
        return reach_m(CARD, height_m) if Mode.PLANAR in modes else 0.0

    def on_machine(self, mode: Mode, policy_sha256: str | None) -> object:
        card = SimpleNamespace(**{**vars(CARD), "mode": mode}, target_range_min_m=5.5)
        return SimpleNamespace(
            card=SimpleNamespace(**vars(card), target_height_min_m=-1.0, target_height_max_m=2.0)
        )


@dataclass
class Scene:
    """Notes the rings, takes everything else."""

    rings: list[Reach] = field(default_factory=list)
    machine_id: str | None = None
    target_m: tuple[float, float, float] | None = None

    def set_reach(self, session_id: str, reach: Reach) -> None:
        self.rings.append(reach)

    def show_machine(self, session_id: str, machine_id: str) -> None:
        """Marks around another machine go, as in the 3D view."""
        if machine_id != self.machine_id:
            self.machine_id, self.target_m = machine_id, None
            self.rings.clear()

    def set_target(self, session_id: str, target_m: tuple[float, float, float] | None) -> None:
        self.target_m = target_m

    def __getattr__(self, name: str):
        return lambda *_: None


@pytest.fixture
def scene() -> Scene:
    return Scene()


@pytest.fixture
def registry() -> SimpleNamespace:
    return SimpleNamespace(on_state=[])


@pytest.fixture
def desk(scene: Scene, registry: SimpleNamespace) -> TargetProposals:
    quiet = SimpleNamespace(
        objects=lambda _: (), watch=lambda *_: None, publish=lambda *_: None, end_session=print
    )
    zones = SimpleNamespace(approved=lambda _: ZoneSet(version_count=0), draft=lambda _: ())
    found = TargetProposals(scene, Shelf(), quiet, zones, quiet, quiet, registry, load_spec())
    found.set_view("s", ViewRequest(machine_id="m001", mode=Mode.PLANAR))
    return found


def test_a_raised_target_has_a_ring_of_its_own(desk: TargetProposals, scene: Scene):
    assert [(ring.planar_m, ring.raised_m) for ring in scene.rings] == [(10.9, None)]
    desk.take_pick("s", (8.0, 0.0, 1.0))
    assert scene.rings[-1].raised_m == pytest.approx(9.95)
    assert (scene.rings[-1].height_m, scene.rings[-1].dimmed_beyond_m) == (1.0, 10.9)
    desk.remove("s", "m001")
    assert scene.rings[-1].raised_m is None
    assert len(scene.rings) == 3


def test_pits_and_slight_heights_keep_the_ring_of_the_ground(desk: TargetProposals, scene: Scene):
    desk.propose("s", "m001", Target(x_m=8.0, y_m=0.0, z_m=-0.8), Mode.PLANAR, "fields")
    desk.propose("s", "m001", Target(x_m=8.0, y_m=0.0, z_m=0.04), Mode.PLANAR, "fields")
    assert len(scene.rings) == 1


def test_moving_at_one_height_draws_no_ring_anew(desk: TargetProposals, scene: Scene):
    for x_m in (7.0, 8.0, 9.0):
        desk.propose("s", "m001", Target(x_m=x_m, y_m=0.0, z_m=2.0), Mode.PLANAR, "fields")
    assert [ring.raised_m for ring in scene.rings] == [None, 9.0]


def test_a_mode_without_a_policy_shows_what_the_others_reach(desk: TargetProposals, scene: Scene):
    desk.propose("s", "m001", Target(x_m=8.0, y_m=0.0, z_m=2.0), Mode.SPATIAL, "fields")
    assert (scene.rings[-1].mode, scene.rings[-1].raised_m) == (None, 9.0)


def test_a_click_for_a_point_is_reported_and_proposes_nothing(
    desk: TargetProposals, monkeypatch: pytest.MonkeyPatch
):
    published: list[object] = []
    monkeypatch.setattr(desk._hub, "publish", lambda event, _: published.append(event))
    desk.set_view("s", ViewRequest(pick_for="point"))
    desk.take_pick("s", (8.0, 1.0, 0.0))
    assert [event.kind for event in published] == ["point.picked"]
    assert desk.target_of("s", "m001") is None
    desk.set_view("s", ViewRequest(pick_for="target"))
    desk.take_pick("s", (8.0, 1.0, 0.0))
    assert published[-1].kind == "target.proposed"


def test_the_rings_follow_the_version_on_board(
    desk: TargetProposals, scene: Scene, registry: SimpleNamespace
):
    (take_state,) = registry.on_state
    known = SimpleNamespace(machine_id="m001")
    for sha256 in ("long", "short", "short"):
        take_state(known, SimpleNamespace(policy_sha256={"2d": sha256}))
    take_state(SimpleNamespace(machine_id="m002"), SimpleNamespace(policy_sha256={}))
    assert [ring.planar_m for ring in scene.rings] == [10.9, 8.0]


def test_rings_and_target_come_back_with_their_machine(desk: TargetProposals, scene: Scene):
    """Also where the target was set before the view asked for the machine, as an address does."""
    desk.propose("s", "m002", Target(x_m=8.0, y_m=1.0), Mode.PLANAR, "fields")
    assert scene.target_m is None
    desk.set_view("s", ViewRequest(machine_id="m002"))
    assert (scene.target_m, len(scene.rings)) == ((8.0, 1.0, 0.0), 1)
    desk.set_view("s", ViewRequest(machine_id="m001"))
    assert (scene.target_m, len(scene.rings)) == (None, 1)
