"""Starts, stops and restarts of the whole service, and what machines make of them."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time

import httpx
import pytest
from sqlalchemy import text

from cli.main import main
from machine.errors import UsageError
from machine.messages import ThrowState
from machine.spec import load_spec
from server.composition import LinkError, open_parts
from server.serve import make_server, open_socket, serve
from server.store.database import Database, DatabaseError, upgrade
from server.store.instance_lock import instance_lock
from server.viewer.scene import ViewerScene
from tests.ports import free_port
from tests.server.server_bench import add_people, make_settings, running_server
from tests.waiting import is_alive, wait_for

PLAN = {"mode": "2d", "target": {"x_m": 6.03, "y_m": 0.0}, "rollout_count": 50}


def test_a_restart_while_armed_disarms_and_keeps_sessions_and_history(tmp_path, swing_policies):
    settings = make_settings(tmp_path / "data", swing_policies)
    with running_server(settings) as first:
        add_people(first.parts)
        machine = first.machine()
        machine.__enter__()
        wait_for(lambda: first.parts.registry.is_connected("m001"))
        with first.client("ada") as ada:
            cookies = dict(ada.cookies)
            epoch = ada.post("/machines/m001/lease").json()["epoch_count"]
            plan = ada.post("/machines/m001/plans", json=PLAN).json()
            path = f"/plans/{plan['plan_id']}"
            wait_for(lambda: ada.get(path).json()["state"] == "ready")
            assert ada.post(f"{path}/arm", json={}).status_code == 200
            assert machine.state is ThrowState.ARMED
    try:
        with running_server(settings) as second:
            wait_for(lambda: machine.state is ThrowState.DISARMED, 60.0)
            assert machine.epoch_count > epoch
            with second.client() as ada:
                ada.cookies.update(cookies)
                assert ada.get("/auth/me").json()["username"] == "ada"
                assert ada.get("/machines/m001").json()["lease"]["holder"] is None
                reply = ada.post(f"{path}/fire")
                assert reply.json()["error"]["code"] == "no_lease"
                ada.post("/machines/m001/lease")
                assert ada.post(f"{path}/fire").json()["error"]["code"] == "not_armed"
                rows = second.parts.audit.verify()
                assert rows.is_intact
        assert not machine.executed
    finally:
        machine.__exit__()


def test_loss_is_seen_within_a_second(running, monkeypatch):
    with running.machine() as machine:
        registry = running.parts.registry
        wait_for(lambda: registry.is_connected("m001"))
        machine.publishes_state = False  # frozen: the token stands, the state does not come
        frozen_s = time.monotonic()
        lost = threading.Event()
        monkeypatch.setattr(registry, "on_lost", [*registry.on_lost, lambda _: lost.set()])
        wait_for(lambda: not registry.is_connected("m001"))
        assert wait_for(lost.is_set)
        # Generous for a loaded computer; the limit itself is machines.FRESH_S.
        assert time.monotonic() - frozen_s < 15.0
        with running.client("vic") as viewer:
            reply = viewer.post("/machines/m001/stop").json()
            assert reply["is_pending"]
        machine.publishes_state = True
        wait_for(lambda: machine.stop_latched)
        # Until it is confirmed it is repeated, also to the next machine of this name.
        wait_for(lambda: not running.parts.stops.is_pending("m001"))


def test_a_second_server_on_the_same_folder_is_refused(tmp_path):
    with (
        instance_lock(tmp_path),
        pytest.raises(UsageError, match="another server"),
        instance_lock(tmp_path),
    ):
        pass
    with instance_lock(tmp_path):
        pass


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(UsageError, match="DOWNRANGE_DATA_DIR"),
        instance_lock(tmp_path / "file" / "data"),
    ):
        pass


def test_a_used_port_is_a_clear_error():
    with open_socket("127.0.0.1", 0) as taken:
        taken.listen()
        with pytest.raises(UsageError, match="DOWNRANGE_PORT"):
            open_socket("127.0.0.1", taken.getsockname()[1])


def test_the_socket_lets_answers_leave_at_once():
    with open_socket("127.0.0.1", 0) as listener:
        # What asyncio looks at before it turns Nagle's algorithm off.
        assert listener.proto == socket.IPPROTO_TCP


def test_a_used_link_endpoint_is_a_clear_error(running, tmp_path):
    settings = make_settings(
        tmp_path, running.settings.policies_dir, link_listen=running.settings.link_listen
    )
    scene = ViewerScene(load_spec(), lambda *_: None)
    with pytest.raises(LinkError, match="DOWNRANGE_LINK_LISTEN"), open_parts(settings, scene):
        pass


def test_an_older_or_newer_database_is_reported_in_one_line(tmp_path, swing_policies):
    settings = make_settings(tmp_path / "data", swing_policies)
    upgrade(settings.resolved_database_url)
    database = Database(settings.resolved_database_url)
    with database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = 'from-the-future'"))
    database.close()
    with pytest.raises(DatabaseError, match="newer than this software"):
        serve(settings)


def test_the_verb_serves_and_ends_in_order(tmp_path, swing_policies, capsys):
    port, link = free_port(), free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "cli.main", "server", "--port", str(port), "--data", str(tmp_path)],
        env={
            "PATH": "/usr/bin:/bin",
            "OPENBLAS_NUM_THREADS": "1",
            "DOWNRANGE_LINK_LISTEN": f"tcp/127.0.0.1:{link}",
            "DOWNRANGE_POLICIES_DIR": str(swing_policies),
            "DOWNRANGE_PREVIEW_WORKER_COUNT": "1",
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )

    def answers():
        assert process.poll() is None
        try:
            return (
                httpx.get(f"http://127.0.0.1:{port}/api/v1/health", timeout=10.0).status_code == 200
            )
        except httpx.TransportError:
            return False

    try:
        wait_for(answers, 160.0)
        assert main(["server", "--port", str(port), "--data", str(tmp_path)]) == 1
        error = capsys.readouterr().err
        assert f"port {port}" in error
        assert len(error.strip().splitlines()) == 1
    finally:
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=120)
    assert process.returncode == 0, output
    assert "leaked" not in output
    assert "Traceback" not in output


def test_a_killed_server_leaves_no_processes(tmp_path, swing_policies):
    code = (
        "import time\n"
        "from server.plans.preview_pool import PreviewPool\n"
        "if __name__ == '__main__':\n"
        "    pool = PreviewPool(2, ())\n"
        "    pool.start()\n"
        "    print(*pool._pool._processes, flush=True)\n"
        "    time.sleep(600)\n"
    )
    script = tmp_path / "killed.py"
    script.write_text(code)
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": "."},
    ) as process:
        assert process.stdout is not None
        children = [int(pid) for pid in process.stdout.readline().split()]
        assert len(children) == 2
        time.sleep(3.0)  # both are past their start
        process.kill()
    wait_for(lambda: not any(is_alive(pid) for pid in children), 30.0)


def test_what_the_server_writes_is_its_owners_alone(tmp_path, swing_policies):
    database = tmp_path / "data" / "downrange.db"
    database.parent.mkdir()
    database.touch(mode=0o644)  # as an earlier version left it
    with running_server(make_settings(tmp_path / "data", swing_policies)):
        names = ["downrange.db", "downrange.db-wal", "downrange.db-shm", "audit-anchors.jsonl"]
        modes = {name: (tmp_path / "data" / name).stat().st_mode & 0o777 for name in names}
    assert modes == dict.fromkeys(names, 0o600)


def test_only_named_proxies_are_believed(tmp_path, swing_policies):
    for proxies, expected in (("", []), ("10.0.0.5, 10.1.0.0/16", ["10.0.0.5", "10.1.0.0/16"])):
        settings = make_settings(tmp_path, swing_policies, trusted_proxies=proxies)
        config = make_server(settings)[0].config
        assert config.proxy_headers is bool(expected)
        assert config.forwarded_allow_ips == expected
    with pytest.raises(ValueError, match="not-an-address"):
        make_settings(tmp_path, swing_policies, trusted_proxies="not-an-address")
