import hashlib
import io
import json

import httpx
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header, Metadata
from mcap.writer import Writer

from machine.conventions import Mode, Motion
from machine.errors import LogError
from machine.messages import Target, ThrowPlan
from machine.spec import load_spec
from machine.starts import safe_pose
from machine.telemetry import BALL_ROW, CONTROL_ROW
from runtime.records.log_writer import write_throw_log
from runtime.records.throw_log import ThrowLog
from server.accounts.accounts import Session
from server.clock import new_id, utc_now
from server.display.replay_control import ReplayControl
from server.errors import NotFoundError
from server.schemas.console import Role
from server.schemas.history import ReplayRequest
from server.store.models import Plan
from server.throws.limited_reader import LimitedLogReader
from server.throws.throw_series import motion_of, series_of
from tests.cases import each
from tests.server.server_bench import wait_for

TICKS = 300
RELEASE_TICK = 200


def make_log(throw_id="t"):
    control = np.zeros(TICKS, CONTROL_ROW)
    control["t_mono_ns"] = 5_000_000_000 + np.arange(TICKS) * 10_000_000
    control["joint_position_rad_m"] = safe_pose()
    control["joint_position_rad_m"][:, 0] = np.linspace(0.0, 0.3, TICKS)
    control["motion_code_count"] = Motion.THROW
    control["motion_code_count"][RELEASE_TICK + 30 :] = Motion.SETTLE
    control["gripper_open_commanded"][RELEASE_TICK:] = True
    control["payload_held"][: RELEASE_TICK + 26] = True
    control["supply_pressure_pa"] = np.nan
    ball = np.zeros(40, BALL_ROW)
    ball["t_mono_ns"] = control["t_mono_ns"][RELEASE_TICK + 26] + np.arange(40) * 20_000_000
    ball["position_m"] = np.linspace((6.0, 0.0, 3.0), (9.0, 0.5, 0.12), 40)
    return ThrowLog(
        {"throw_id": throw_id, "machine_id": "m001", "mode": "2d"},
        control,
        ball=ball,
        impact_t_mono_ns=int(ball["t_mono_ns"][-1]),
    )


@pytest.fixture
def content(tmp_path):
    write_throw_log(tmp_path / "log.mcap", make_log())
    return (tmp_path / "log.mcap").read_bytes()


def some_session():
    return Session(new_id(), "ada", Role.OPERATOR, utc_now())


def some_plan():
    return ThrowPlan(
        plan_id="none",
        machine_id="m001",
        mode=Mode.PLANAR,
        target=Target(x_m=9.0, y_m=0.0),
        policy_sha256="a" * 64,
        model_sha256=load_spec().sha256,
        twin_profile_version=0,
        predicted_impact_m=(9.0, 0.0, 0.0),
    )


@pytest.fixture
def throw_id(running):
    throw_id = new_id()
    with running.parts.database.write() as database:
        database.add(running.parts.throws.new_row(throw_id, some_plan(), some_session(), 1))
    return throw_id


def put(running, throw_id, content, *, machine_id="m001", token=None, sha256=None, chunked=False):
    token = token or running.parts.registry.secret_path("m001").read_text().strip()
    return httpx.put(
        f"{running.url}/api/v1/machines/{machine_id}/throw-logs/{throw_id}",
        content=iter([content[:1000], content[1000:]]) if chunked else content,
        headers={
            "Authorization": f"Bearer {token}",
            "X-Content-SHA256": sha256 or hashlib.sha256(content).hexdigest(),
        },
    )


def stored_files(running):
    return sorted(p.name for p in (running.settings.data_dir / "throws").rglob("*") if p.is_file())


@each("chunked", [False, True])
def test_an_upload_is_kept_once_and_can_be_read(running, ada, content, throw_id, chunked):
    for _ in range(2):
        assert put(running, throw_id, content, chunked=chunked).status_code == 204
    detail = ada.get(f"/throws/{throw_id}").json()
    assert detail["row"]["has_log"]
    assert detail["log"]["log_sha256"] == hashlib.sha256(content).hexdigest()
    assert detail["log"]["size_bytes"] == len(content)
    assert ada.get(f"/throws/{throw_id}/log").content == content
    table = ada.get(f"/throws/{throw_id}/csv")
    assert table.headers["content-type"].startswith("text/csv")
    assert "boom_valve_applied_ratio" in table.text
    assert not [name for name in stored_files(running) if name.endswith(".part")]


def test_wrong_tokens_are_refused(running, content, throw_id):
    other = running.parts.registry.secret_path("m002").read_text().strip()
    for token in ("x", other, ""):
        reply = put(running, throw_id, content, token=token or "Bearer")
        assert (reply.status_code, reply.json()["error"]["code"]) == (401, "wrong_token")


def test_another_machines_throw_is_refused(running, content, throw_id):
    token = running.parts.registry.secret_path("m002").read_text().strip()
    reply = put(running, throw_id, content, machine_id="m002", token=token)
    assert (reply.status_code, reply.json()["error"]["code"]) == (403, "wrong_machine")


def test_a_log_of_no_known_throw_is_refused_before_it_is_written(running, content):
    before = stored_files(running)
    reply = put(running, new_id(), content)
    assert (reply.status_code, reply.json()["error"]["code"]) == (404, "no_throw")
    assert stored_files(running) == before


def hostile_logs(content):
    """Uploads by name: bombs, sizes that lie, deep JSON, another compression, noise."""
    for name, compression, chunk in (
        ("bomb", "zstd", zstandard.compress(bytes(60 * 1024 * 1024))),
        ("size lies", "zstd", zstandard.compress(bytes(10_000))),
        ("no size", "zstd", zstandard.ZstdCompressor(write_content_size=False).compress(b"x")),
        ("lz4", "lz4", b"x" * 100),
    ):
        size = 60 * 1024 * 1024 if name == "bomb" else 10
        yield name, with_chunks(content, compression, chunk, size, 4 if name == "bomb" else 1)
    yield "deep", deep_log()


def with_chunks(content, compression, data, size_bytes, count):
    stream = io.BytesIO()
    stream.write(content[:8])  # the magic bytes
    records = RecordBuilder()
    Header(profile="downrange", library="x").write(records)
    Metadata(name="throw", metadata={"json": json.dumps({"log_schema_version": 1})}).write(records)
    for _ in range(count):
        Chunk(
            compression=compression,
            data=data,
            message_start_time=0,
            message_end_time=0,
            uncompressed_crc=0,
            uncompressed_size=size_bytes,
        ).write(records)
    stream.write(records.end())
    return stream.getvalue()


def deep_log():
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("downrange", "x")
    writer.add_metadata("throw", {"json": "[" * 100_000})
    schema = writer.register_schema("control", "jsonschema", b"{}")
    channel = writer.register_channel("/control", "json", schema)
    writer.add_message(channel, 0, b"[" * 100_000, 0)
    writer.finish()
    return stream.getvalue()


def test_hostile_logs_are_errors_and_cost_little(running, ada, content):
    for name, hostile in hostile_logs(content):
        throw_id = new_id()
        with running.parts.database.write() as database:
            database.add(running.parts.throws.new_row(throw_id, some_plan(), some_session(), 1))
        assert put(running, throw_id, hostile).status_code == 204, name
        # Both are read in the same way; each refusal ends a process.
        reply = ada.get(f"/throws/{throw_id}/{'csv' if name == 'bomb' else 'series'}")
        assert reply.status_code == 409, (name, reply.text)
        assert reply.json()["error"]["code"] in ("log_unreadable", "no_motion"), name


def test_a_log_that_takes_too_long_ends_its_process_and_the_next_is_read(tmp_path, content):
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    reader = LimitedLogReader()
    try:
        assert len(reader.read(path).control) == TICKS
        reader._process._read_s = 0.0
        with pytest.raises(LogError, match="more than 0 s"):
            reader.read(path)
        reader._process._read_s = 60.0
        assert len(reader.read(path).control) == TICKS
    finally:
        reader.close()


def test_damaged_uploads_leave_nothing_and_may_be_repeated(running, content, throw_id):
    before = stored_files(running)
    reply = put(running, throw_id, content, sha256="0" * 64)
    assert (reply.status_code, reply.json()["error"]["code"]) == (503, "hash_mismatch")
    assert put(running, throw_id, b"", sha256=hashlib.sha256(b"").hexdigest()).status_code == 503
    assert put(running, throw_id, content, sha256="zz").status_code == 400
    assert put(running, "..%2f..%2fetc", content).status_code in (400, 404)
    for odd in ("a%0A", "a%00", "a%20b", "%2e%2e", "a" * 65):
        assert put(running, odd, content).status_code in (400, 404)
    assert stored_files(running) == before


def test_too_large_uploads_are_refused(running, throw_id):
    big = b"x" * (running.settings.log_max_bytes + 1)
    reply = put(running, throw_id, big)
    assert (reply.status_code, reply.json()["error"]["code"]) == (413, "log_too_large")


def test_an_unreadable_log_is_kept_but_says_so(running, ada, throw_id):
    assert put(running, throw_id, b"not a log").status_code == 204
    reply = ada.get(f"/throws/{throw_id}/series")
    assert (reply.status_code, reply.json()["error"]["code"]) == (409, "log_unreadable")


def test_series_and_replay_over_http(running, ada, content, throw_id):
    put(running, throw_id, content)
    series = ada.get(f"/throws/{throw_id}/series").json()
    assert len(series["t_s"]) == TICKS
    assert series["release_s"] == pytest.approx(2.26)
    assert series["columns"]["supply_pressure_pa"][0] is None
    started = ada.post(f"/throws/{throw_id}/replay", json={"playing": True}).json()
    assert started["is_playing"]
    assert started["duration_s"] > 2.9
    paused = ada.post(f"/throws/{throw_id}/replay", json={"at_s": 1.5, "playing": False}).json()
    assert (paused["at_s"], paused["is_playing"]) == (1.5, False)
    session_id = ada.get("/auth/me").json()["session_id"]
    wait_for(lambda: running.parts.scene.replay_state(session_id))
    assert ada.post(f"/throws/{throw_id}/replay", json={"close": True}).status_code == 200
    wait_for(lambda: running.parts.scene.replay_state(session_id) is None)


class Seen:
    """Takes down what a scene was asked to replay."""

    def __init__(self):
        self.kwargs = {}

    def replay(self, session_id, motion, **kwargs):
        self.kwargs = kwargs

    def replay_control(self, session_id, **kwargs):
        """Nothing to steer."""

    def replay_state(self, session_id):
        return None


class Kept:
    """A log store and a plan store of one throw; its plan has lost the predicted motion."""

    def __init__(self, site):
        self._site = site

    def read(self, throw_id):
        return make_log(throw_id)

    def row(self, plan_id):
        if self._site is None:
            raise NotFoundError("no_plan", "gone")
        return Plan(plan_id=plan_id, site=self._site)

    def frames(self, plan_id):
        raise NotFoundError("no_frames", "gone")


BED = {"name": "bed", "kind": "box", "x_m": 9.0, "y_m": 0.0, "length_m": 2.0, "width_m": 2.0,
       "height_m": 1.0}  # fmt: skip


@each(("kept", "names"), [([BED], ["bed"]), ([], []), (None, None)])
def test_a_replay_is_given_the_site_of_its_plan(kept, names):
    scene, store = Seen(), Kept(kept)
    session = Session(new_id(), "ada", Role.OPERATOR, utc_now())
    ReplayControl(store, store, scene).control("t", "p", ReplayRequest(playing=True), session)
    site = scene.kwargs["site"]
    assert (None if site is None else [item.name for item in site]) == names


def test_marks_are_added_never_overwritten(running, ada, throw_id):
    first = {"downrange_error_m": 0.3, "crossrange_error_m": -0.2, "note": "seen"}
    assert ada.post(f"/throws/{throw_id}/impacts", json=first).json()["x_m"] == pytest.approx(9.3)
    second = ada.post(f"/throws/{throw_id}/impacts", json={"x_m": 9.5, "y_m": 0.1}).json()
    assert second["downrange_error_m"] == pytest.approx(0.5)
    detail = ada.get(f"/throws/{throw_id}").json()
    assert [i["is_current"] for i in detail["impacts"]] == [False, True]
    assert [i["recorded_by"] for i in detail["impacts"]] == ["ada", "ada"]
    assert detail["row"]["measured_crossrange_error_m"] == pytest.approx(0.1)
    for bad in ({}, {"x_m": 1}, {**first, "x_m": 1.0, "y_m": 1.0}, {"x_m": 1e9, "y_m": 0}):
        assert ada.post(f"/throws/{throw_id}/impacts", json=bad).status_code == 422


def test_series_of_a_log():
    series = series_of("t", make_log())
    assert series.t_s[0] == 0.0
    assert [band.name for band in series.phases] == ["swing", "settle", "flight"]
    assert series.impact_s == pytest.approx(2.26 + 39 * 0.02)
    assert len(series.ball_t_s) == 40
    assert set(map(len, series.columns.values())) == {TICKS}


def test_series_of_an_empty_log():
    series = series_of("t", ThrowLog({"throw_id": "t"}))
    assert (series.t_s, series.phases, series.release_s) == ((), (), None)
    with pytest.raises(ValueError, match="no motion"):
        motion_of(ThrowLog({"throw_id": "t"}))


def test_motion_of_a_log_flies_evenly_from_release_to_impact():
    motion = motion_of(make_log())
    assert motion.frames_rad_m.shape == (TICKS, 6)
    assert motion.frame_period_s == pytest.approx(0.01)
    assert motion.release_s == pytest.approx(2.26)
    assert motion.flight_s == pytest.approx(39 * 0.02)
    assert motion.ball_path_m[0] == pytest.approx([6.0, 0.0, 3.0])
    assert motion.ball_path_m[-1] == pytest.approx([9.0, 0.5, 0.12])
