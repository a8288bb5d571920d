import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from machine.conventions import Mode
from machine.messages import LandingEllipse
from machine.site.objects import SiteObject
from machine.starts import safe_pose
from server.viewer.replay import ThrowMotion
from server.viewer.scene import ViewerScene
from server.viewer.shapes import LaidMaterial, LoadFootprint
from server.viewer.stage import lost_text
from server.viewer.state import Reach, ShownPlan
from tests.cases import each
from tests.server.viewer_app import CAMERA, ViewClient, ViewerApp, click, drag
from tests.waiting import until

POSE = safe_pose(0.3)
ELLIPSE = LandingEllipse(
    mean_downrange_error_m=0.05,
    mean_crossrange_error_m=0.0,
    sd_downrange_m=0.2,
    sd_crossrange_m=0.1,
    correlation_ratio=0.0,
    rollout_count=200,
    landed_count=200,
)
UPPER = "/live/chassis/upper"
BED = SiteObject(name="bed", kind="box", x_m=9.0, y_m=3.0, length_m=3.0, width_m=3.0, height_m=1.0)
PIT = SiteObject(name="pit", kind="pit", x_m=9.0, y_m=-5.0, length_m=2.0, width_m=2.0, height_m=0.8)


def motion(duration_s: float = 0.3) -> ThrowMotion:
    frames = POSE + np.linspace(0.0, 1.0, 16)[:, None] * np.array([1.0, 0.2, 0.1, 0.3, 0.2, 0.0])
    path = np.linspace([5.0, 0.0, 3.0], [9.0, 1.0, 0.12], 8)
    return ThrowMotion(frames, duration_s / 15.0, path, duration_s / 2.0, duration_s / 2.0)


def label(client: ViewClient) -> str | None:
    return client.nodes.get("/site/0/label", {}).get("text")


@pytest.fixture(scope="module")
def app() -> Iterator[ViewerApp]:
    opened = ViewerApp()
    yield opened
    opened.close()


@pytest.fixture
def session(request: pytest.FixtureRequest) -> str:
    return request.node.name


@pytest.fixture
def client(app: ViewerApp, session: str) -> Iterator[ViewClient]:
    """A drawn view of machine m001, one a test."""
    app.scene.update_machine("m001", POSE)
    app.scene.show_machine(session, "m001")
    found = ViewClient(app, session)
    found.send(CAMERA)
    found.until(lambda: f"{UPPER}/skin" in found.nodes, "the machine")
    yield found
    found.close()
    app.scene.end_session(session)


def test_the_machine_is_drawn_where_it_is(client: ViewClient) -> None:
    client.until(lambda: client.nodes[UPPER].get("wxyz"), "its pose")
    assert client.nodes[UPPER]["wxyz"] == pytest.approx([np.cos(0.15), 0.0, 0.0, np.sin(0.15)])
    assert {"/ground", "/grid", "/sun", "/sky"} <= set(client.nodes)
    assert f"{UPPER}/boom/boom_rod/skin" in client.nodes


def test_only_what_moved_is_sent(app: ViewerApp, client: ViewClient) -> None:
    client.until(lambda: client.nodes[UPPER].get("wxyz"), "its pose")
    before = 0
    # Messages keep their order: what the drawing itself still had to say lies before the second turn.
    for turn_rad in (0.6, 0.8, 1.0):
        before = len(client.messages)
        turned = POSE.copy()
        turned[0] = turn_rad
        app.scene.update_machine("m001", turned)
        half = float(np.sin(0.5 * turn_rad))
        client.until(
            lambda half=half: client.nodes[UPPER]["wxyz"][3] == pytest.approx(half), "the turn"
        )
    moved = {m["name"] for m in client.messages[before:] if m["type"].startswith("Set")}
    assert moved == {UPPER}


def test_a_load_in_flight_leaves_the_gripper(app: ViewerApp, client: ViewClient) -> None:
    payload = next(name for name in client.nodes if name.endswith("/gripper/payload"))
    app.scene.update_machine("m001", POSE, (8.0, 1.0, 2.0))
    client.until(lambda: client.nodes.get("/ball_live", {}).get("position"), "the ball")
    assert client.nodes["/ball_live"]["position"] == pytest.approx([8.0, 1.0, 2.0])
    client.until(lambda: client.nodes[payload]["visible"] is False, "the empty gripper")
    app.scene.update_machine("m001", POSE)
    client.until(lambda: client.nodes["/ball_live"]["visible"] is False, "the ball to go")
    client.until(lambda: client.nodes[payload]["visible"] is True, "the load")


def test_no_other_session_sees_a_sessions_marks(app: ViewerApp, client: ViewClient) -> None:
    app.scene.update_machine("m002", POSE)
    app.scene.show_machine("other", "m002")
    other = ViewClient(app, "other")
    other.send(CAMERA)
    other.until(lambda: f"{UPPER}/skin" in other.nodes, "the other machine")
    app.scene.set_target("other", (9.0, 0.0, 0.0))
    other.until(lambda: "/target" in other.nodes, "the other's target")
    app.scene.set_reach(client_session(app, client), Reach(7.5))
    client.until(lambda: "/reach/static" in client.nodes, "our rings")
    assert "/target" not in client.nodes
    assert "/reach/static" not in other.nodes
    other.close()
    app.scene.end_session("other")


def client_session(app: ViewerApp, client: ViewClient) -> str:
    """The session that this client's cookie names."""
    cookie = client.socket.request.headers["Cookie"] if client.socket.request else ""
    return cookie.removeprefix("sid=")


def test_rings_labels_and_dimmed_ground(app: ViewerApp, session: str, client: ViewClient) -> None:
    app.scene.set_reach(session, Reach(7.5, 10.9, 11.4, 5.0, Mode.PLANAR))
    client.until(lambda: "/reach/spatial_label" in client.nodes, "the labels")
    texts = {client.nodes[f"/reach/{n}_label"]["text"] for n in ("static", "planar", "spatial")}
    assert texts == {"7.5 m static reach", "10.9 m 2D", "11.4 m 3D"}
    assert {"/dim/beyond", "/dim/near"} <= set(client.nodes)
    assert "/reach/raised" not in client.nodes
    app.scene.set_reach(session, Reach(7.5, 10.9, 10.92, 5.0, Mode.PLANAR))
    client.until(
        lambda: client.nodes.get("/reach/planar_label", {}).get("text") == "10.9 m 2D and 3D",
        "one ring where both are alike",
    )
    assert "/reach/spatial_label" not in client.nodes
    raised = Reach(7.5, 10.9, 11.4, 5.0, Mode.PLANAR, raised_m=10.3, height_m=1.2)
    app.scene.set_reach(session, raised)
    client.until(lambda: "/reach/raised_label" in client.nodes, "the ring of the target's height")
    assert client.nodes["/reach/raised_label"]["text"] == "10.3 m 2D at +1.20 m"
    assert client.nodes["/reach/raised"]["position"][2] == pytest.approx(1.23)
    app.scene.set_reach(session, None)
    client.until(lambda: "/reach/static" not in client.nodes, "the rings to go")
    client.until(lambda: "/dim/beyond" not in client.nodes, "the dimming to go")


@each(
    ("reach", "beyond_m"),
    [
        (Reach(7.5), 7.5),
        (Reach(7.5, 10.9, 11.4), 11.4),
        (Reach(7.5, 10.9, 11.4, mode=Mode.PLANAR), 10.9),
        (Reach(7.5, None, 11.4, mode=Mode.PLANAR), 11.4),
    ],
)
def test_where_the_ground_is_dimmed(reach: Reach, beyond_m: float) -> None:
    assert reach.dimmed_beyond_m == beyond_m


def test_the_target_moves_without_being_made_anew(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.set_target(session, (9.0, 0.0, 0.0))
    client.until(lambda: "/target/label" in client.nodes, "the mark")
    assert client.nodes["/target/label"]["text"] == "9.00 m, ahead"
    made = sum(m["type"] == "FrameMessage" for m in client.messages)
    app.scene.set_target(session, (0.0, 8.0, 0.5))
    client.until(lambda: client.nodes["/target/label"]["text"].startswith("8.00 m"), "the words")
    assert client.nodes["/target/label"]["text"] == "8.00 m, 90.0° left, +0.50 m high"
    assert client.nodes["/target"]["position"][:2] == pytest.approx([0.0, 8.0])
    assert sum(m["type"] == "FrameMessage" for m in client.messages) == made
    app.scene.set_target(session, None)
    client.until(lambda: "/target" not in client.nodes, "the mark to go")


def test_a_click_marks_the_target_and_tells(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.set_site(session, [BED, PIT])
    client.until(lambda: "/site/1/edges" in client.nodes, "the bed and the pit")
    assert client.nodes["/site/0/label"]["text"] == "bed"
    client.send(click((0.0, 0.0, 7.0), (1.5, 0.5, -1.0)))
    client.until(lambda: client.nodes.get("/target", {}).get("position"), "the mark")
    assert client.nodes["/target"]["position"] == pytest.approx([9.0, 3.0, 1.03])
    until(lambda: app.picks and app.picks[-1][0] == session, "the pick")
    assert app.picks[-1][1] == pytest.approx((9.0, 3.0, 1.0), abs=1e-5)


def test_what_stands_around_is_drawn_changed_and_outlives_the_colours(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.set_site(session, [BED, PIT])
    client.until(lambda: "/site/1/label" in client.nodes, "both")
    app.scene.set_theme(session, "dark")
    client.until(lambda: "/site/1/label" in client.nodes, "both in the dark")
    app.scene.set_site(session, [PIT])
    client.until(lambda: "/site/1" not in client.nodes, "the bed to go")
    client.until(lambda: label(client) == "pit", "the pit")
    assert "/ground" in client.nodes


def test_clicks_that_give_no_target_are_reported_and_draw_nothing(
    app: ViewerApp, session: str, client: ViewClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    picks, refusals = len(app.picks), len(app.refusals)
    handled: list[object] = []
    original = app.scene._stage._clicked

    def noting(session_id: str, event: Any) -> None:
        original(session_id, event)
        handled.append(event)

    monkeypatch.setattr(app.scene._stage, "_clicked", noting)
    client.send(click((0.0, 0.0, 7.0), (1.0, 0.0, -0.01)))
    until(lambda: len(app.refusals) > refusals, "the refusal")
    app.scene.set_picking(session, False)
    state = app.scene._stage.session(session)
    until(lambda: state is not None and not state.is_picking, "picking to be off")
    client.send(click((0.0, 0.0, 7.0), (1.5, 0.5, -1.0)))
    until(lambda: len(handled) == 2, "the second click to be handled")
    app.scene.set_reach(session, Reach(7.5))
    client.until(lambda: "/reach/static" in client.nodes, "what was asked later")
    assert "/target" not in client.nodes
    assert len(app.picks) == picks


def test_a_plan_is_drawn_and_its_ghost_plays_once(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.show_plan(session, (9.0, 1.0, 0.0), motion(), impact_m=(9.05, 1.0, 0.12))
    client.until(lambda: "/ghost/chassis/upper/skin" in client.nodes, "the ghost")
    assert client.nodes["/ghost/chassis/upper/skin"]["opacity"] < 0.5
    assert "/ghost/chassis/skin" not in client.nodes
    assert {"/plan/path", "/plan/impact", "/target"} <= set(client.nodes)
    assert "/plan/sigma1" not in client.nodes
    app.scene.update_ellipse(session, ELLIPSE)
    client.until(lambda: "/plan/sigma2_fill" in client.nodes, "the ellipse")
    client.until(lambda: "/ball_ghost" in client.nodes, "the ghost's load in flight")
    client.until(lambda: "/ghost" not in client.nodes, "the ghost to end")
    assert "/plan/path" in client.nodes
    app.scene.play_preview(session)
    client.until(lambda: "/ghost" in client.nodes, "the ghost once more")
    app.scene.clear_plan(session)
    client.until(
        lambda: not any(n.startswith(("/plan/", "/ghost")) for n in client.nodes), "no plan"
    )
    assert "/target" in client.nodes


def test_a_dragged_target_takes_its_ellipse_along(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.show_plan(session, (9.0, 0.0, 0.0), motion(), ellipse=ELLIPSE)
    client.until(lambda: "/plan/sigma1_fill" in client.nodes, "the ellipse")
    before = len(app.picks)
    bindings = [m for m in client.messages if m["type"] == "SetSceneNodeDragBindingsMessage"]
    owner = next(m["owner"] for m in bindings if m["name"] == "/target/handle")
    client.send(drag("start", (9.0, 0.0, 0.0), owner))
    for x_m in (8.5, 8.0, 7.5):
        client.send(drag("update", (x_m, 1.0, 0.0), owner))
    client.send(drag("end", (7.5, 1.0, 0.0), owner))
    until(
        lambda: app.picks[before:] and app.picks[-1][1] == pytest.approx((7.5, 1.0, 0.0)),
        "the last place of the pointer",
    )
    client.until(
        lambda: client.nodes["/target"]["position"][:2] == pytest.approx([7.5, 1.0]), "the mark"
    )
    # Of the preview only the outline stays, as an estimate at the new place.
    client.until(lambda: "/plan/path" not in client.nodes, "the path to go")
    client.until(lambda: "/plan/sigma1" in client.nodes, "the estimate")
    assert "/plan/sigma1_fill" not in client.nodes
    # A preview of where the target no longer is does not pull it back.
    app.scene.show_plan(session, (9.0, 0.0, 0.0), motion(), ellipse=ELLIPSE)
    app.scene.show_plan(session, (7.5, 1.0, 0.0), motion(), ellipse=ELLIPSE)
    client.until(lambda: "/plan/sigma1_fill" in client.nodes, "the new preview")
    assert client.nodes["/target"]["position"][:2] == pytest.approx([7.5, 1.0])


def test_clicks_for_a_point_leave_the_target(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.set_target(session, (9.0, 0.0, 0.0))
    app.scene.set_pick_for(session, "point")
    client.until(lambda: "/target" in client.nodes, "the target")
    until(lambda: app.scene._stage.session(session).pick_for == "point", "the mode of clicks")
    before = len(app.picks)
    client.send(click((0.0, 0.0, 5.0), (1.5, 0.5, -1.0)))
    until(lambda: len(app.picks) > before, "the point")
    state = app.scene._stage.session(session)
    assert state is not None
    assert state.target_m == (9.0, 0.0, 0.0)


def test_an_estimate_turns_with_the_target_and_grows_with_its_range() -> None:
    plan = ShownPlan((8.0, 0.0, 0.0), motion(), (8.0, 0.1, 0.0), ELLIPSE)
    moved = plan.estimate_at((0.0, 10.0, 0.0))
    assert moved.is_estimate
    assert moved.impact_m is None
    assert moved.ellipse is not None
    assert moved.ellipse.sd_downrange_m == pytest.approx(0.25)
    assert moved.ellipse.sd_crossrange_m == pytest.approx(0.125)
    assert moved.ellipse.mean_downrange_error_m == ELLIPSE.mean_downrange_error_m


def test_a_ghost_draws_only_what_leaves_the_live_machine(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    frames = np.tile(POSE, (4, 1))
    frames[:, 0] += 2.0 * np.pi
    still = ThrowMotion(frames, 5.0, np.zeros((0, 3)))
    app.scene.show_plan(session, (9.0, 1.0, 0.0), still)
    client.until(lambda: "/ghost/chassis/upper/boom/skin" in client.nodes, "the ghost")
    client.until(lambda: "/ghost/chassis/upper/boom/dipper/skin" in client.nodes, "its arm")
    assert "/ghost/chassis/upper/skin" not in client.nodes
    assert "/ghost/chassis/skin" not in client.nodes


def test_a_replay_hides_the_live_machine(app: ViewerApp, session: str, client: ViewClient) -> None:
    app.scene.replay(session, motion(30.0), predicted=motion(30.0), is_playing=False)
    client.until(lambda: "/replay/chassis/upper" in client.nodes, "the replay")
    client.until(lambda: client.nodes["/live"]["visible"] is False, "the live machine to hide")
    client.until(lambda: "/ghost" in client.nodes, "the prediction beside it")
    app.scene.replay_control(session, at_s=30.0)
    upper = "/replay/chassis/upper"
    turned = [np.cos(0.65), 0.0, 0.0, np.sin(0.65)]
    client.until(lambda: client.nodes[upper].get("wxyz") == pytest.approx(turned), "the last frame")
    state = app.scene.replay_state(session)
    assert state is not None
    assert (state.at_s, state.duration_s, state.is_playing) == (30.0, pytest.approx(30.0), False)
    app.scene.replay_control(session, is_playing=True)
    until(lambda: 0.0 < (app.scene.replay_state(session) or state).at_s < 30.0, "it to play on")
    app.scene.stop_replay(session)
    client.until(lambda: "/replay" not in client.nodes, "the replay to go")
    client.until(lambda: client.nodes["/live"]["visible"] is True, "the live machine")
    assert app.scene.replay_state(session) is None


def test_a_replay_has_its_throws_site(app: ViewerApp, session: str, client: ViewClient) -> None:
    app.scene.set_site(session, [PIT])
    app.scene.replay(session, motion(30.0), is_playing=False, site=[BED])
    client.until(lambda: label(client) == "bed", "the bed of then")
    app.scene.stop_replay(session)
    client.until(lambda: label(client) == "pit", "today's site again")


def test_bulk_material_is_drawn_with_its_lines_and_goes_at_a_replay(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    vertices = np.array([[8.0, 0.0, 0.3], [9.0, 0.0, 0.3], [8.5, 1.0, 0.8]])
    faces = np.array([[0, 1, 2]])
    load = LoadFootprint(vertices, faces, (8.5, 0.5, 0.5), "1: 0.20 m³")
    material = LaidMaterial(vertices, faces, vertices[None, :2], (load,))
    app.scene.set_material(session, material)
    client.until(lambda: "/next_loads/0/label" in client.nodes, "the material and what is next")
    assert "/material/contours" in client.nodes
    app.scene.replay(session, motion(30.0), is_playing=False)
    client.until(lambda: "/material" not in client.nodes, "the material of today to go")
    app.scene.stop_replay(session)
    client.until(lambda: "/material" in client.nodes, "it again")
    app.scene.set_material(session, None)
    client.until(
        lambda: not {"/material", "/next_loads/0"} & set(client.nodes), "it to go with its job"
    )


def test_a_lost_machine_says_since_when_and_turns_grey(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.update_machine("m404", POSE)
    app.scene.show_machine(session, "m404")
    app.scene.mark_lost("m404", 14.2)
    client.until(lambda: "/lost" in client.nodes, "the words")
    first = client.nodes["/lost"]["text"]
    assert re.fullmatch(r"Lost: last seen 1[45] s ago", first)
    client.until(lambda: client.nodes["/live/chassis/skin"].get("opacity"), "the grey machine")
    client.until(lambda: client.nodes["/lost"]["text"] != first, "a later second")
    app.scene.update_machine("m404", POSE)
    client.until(lambda: "/lost" not in client.nodes, "the words to go")
    client.until(lambda: client.nodes["/live/chassis/skin"]["type"] == "GlbMessage", "its colours")


@each(
    ("ago_s", "text"),
    [
        (-0.5, "Lost: last seen 0 s ago"),
        (119.0, "Lost: last seen 119 s ago"),
        (120.0, "Lost: last seen 2 min ago"),
        (7200.0, "Lost: last seen 2 h ago"),
    ],
)
def test_how_long_ago_in_words(ago_s: float, text: str) -> None:
    assert lost_text(ago_s) == text


def test_impacts_are_marked_and_cleared(app: ViewerApp, session: str, client: ViewClient) -> None:
    app.scene.show_impacts(
        session,
        [(9.0, 0.1, 0.0), (8.9, 0.0, 0.0)],
        latest=(9.1, 0.0, 0.0),
        latest_text="+0.10 m long",
    )
    client.until(lambda: "/impacts/latest_label" in client.nodes, "the marks")
    assert {"/impacts/past", "/impacts/latest"} <= set(client.nodes)
    assert client.nodes["/impacts/latest_label"]["text"] == "+0.10 m long"
    app.scene.show_impacts(session, [])
    client.until(lambda: "/impacts/past" not in client.nodes, "the crosses to go")


def test_a_browser_that_comes_back_sees_the_same(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.set_target(session, (9.0, 0.0, 0.0))
    app.scene.show_plan(session, (9.0, 0.0, 0.0), motion(0.01), ellipse=ELLIPSE)
    app.scene.set_theme(session, "dark")
    client.close()
    again = ViewClient(app, session)
    again.send(CAMERA)
    again.until(lambda: f"{UPPER}/skin" in again.nodes, "the machine")
    again.until(lambda: "/target/label" in again.nodes, "the target")
    assert "/plan/sigma1" in again.nodes
    themes = [m for m in again.messages if m["type"] == "ThemeConfigurationMessage"]
    assert themes[-1]["dark_mode"] is True
    assert themes[-1]["show_share_button"] is False
    again.close()


def test_another_machine_starts_with_a_clean_yard(
    app: ViewerApp, session: str, client: ViewClient
) -> None:
    app.scene.set_target(session, (9.0, 0.0, 0.0))
    app.scene.set_reach(session, Reach(7.5))
    client.until(lambda: "/reach/static" in client.nodes, "the rings")
    app.scene.show_machine(session, "m003")
    client.until(lambda: "/target" not in client.nodes, "the target to go")
    client.until(lambda: "/live" not in client.nodes, "the old machine to go")
    client.until(lambda: "/reach/static" not in client.nodes, "the rings to go")


def test_camera_presets(app: ViewerApp, session: str, client: ViewClient) -> None:
    app.scene.set_camera(session, "top")

    def asked(kind: str) -> list[dict[str, Any]]:
        return [m for m in client.messages if m["type"] == kind and not m["initial"]]

    client.until(
        lambda: any(m["position"][2] > 40.0 for m in asked("SetCameraPositionMessage")), "the map"
    )
    with pytest.raises(ValueError, match="3d, top, side"):
        app.scene.set_camera(session, "below")
    with pytest.raises(ValueError, match="light, dark"):
        app.scene.set_theme(session, "pink")


@each("joints", [[0.0] * 5, [0.0] * 7, [float("nan")] * 6])
def test_a_sample_that_is_none_is_refused(app: ViewerApp, joints: list[float]) -> None:
    with pytest.raises(ValueError, match="Six finite"):
        app.scene.update_machine("m001", joints)


def test_one_failing_job_does_not_end_the_view(
    app: ViewerApp, session: str, client: ViewClient, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("planted")

    app.scene._stage.apply(session, fail, None)
    app.scene.set_target(session, (9.0, 0.0, 0.0))
    client.until(lambda: "/target" in client.nodes, "the target after the failure")
    assert "planted" in caplog.text


def test_the_oldest_session_that_nobody_watches_is_forgotten(
    app: ViewerApp, session: str, client: ViewClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.viewer.stage.MAX_SESSIONS", 3)
    names = [f"{session}{i}" for i in range(6)]
    for name in names:
        app.scene.set_picking(name, True)
    until(lambda: app.scene._stage.session(names[-1]), "the newest")
    assert app.scene._stage.session(session) is not None
    assert app.scene._stage.session(names[0]) is None
    for name in names:
        app.scene.end_session(name)


def test_what_is_not_started_says_so() -> None:
    from machine.spec import load_spec

    scene = ViewerScene(load_spec(), lambda *_: None)
    with pytest.raises(RuntimeError, match="start"):
        _ = scene.port
    scene.close()
