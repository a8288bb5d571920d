import json

import pytest

from cli.service.throw import parse_target, run
from cli.service.throw_client import ServerError, ServerLogin, ThrowClient, login_from_file
from machine.errors import UsageError
from tests.cases import each
from tests.server.server_bench import wait_for

PASSWORD = "correct horse battery"


@pytest.fixture
def login(tmp_path):
    path = tmp_path / "password"
    path.write_text(f"{PASSWORD}\n")
    return path


def throw(running, login, **arguments):
    return run(login=ServerLogin(running.url, "bob", login), **arguments)


def test_one_command_throws_and_reports(running, machine, login, capsys):
    machine.payload_held = False  # the client asks for a load by itself
    wait_for(lambda: not running.parts.registry.get("m001").state.payload_held)
    assert throw(running, login, target="6.03", as_json=True) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) >= {"throw_id", "state", "predicted", "impact", "seconds"}
    assert report["state"] == "landed"
    assert report["impact"] == pytest.approx(
        {"downrange_error_m": 0.12, "crossrange_error_m": -0.05}
    )
    assert abs(report["predicted"]["downrange_error_m"]) < 0.5
    assert machine.executed == [report["throw_id"]]
    assert all(beat.is_holding for _, beat in machine.heartbeats[:-1])
    assert running.parts.leases.view("m001").holder is None


def test_words_for_people(running, machine, login, capsys):
    assert throw(running, login, target="6.03,0.1") == 0
    text = capsys.readouterr().out
    assert "+0.12 m long, -0.05 m right" in text


def test_an_aborted_throw_has_its_own_exit_code(running, machine, login, monkeypatch):
    machine.swing_s = 60.0
    monkeypatch.setattr("cli.service.throw_client.Holding._run", lambda self: None)
    assert throw(running, login, target="6.03") == 3


def test_refusals_are_passed_on(running, machine, login):
    with pytest.raises(ServerError, match=r"11\.40 m.*reaches"):
        throw(running, login, target="11.4")
    with pytest.raises(ServerError, match="no machine"):
        throw(running, login, target="9", machine="nobody")
    assert running.parts.leases.view("m001").holder is None


def test_who_and_where_are_checked(running, login, tmp_path):
    with pytest.raises(ServerError, match="wrong"):
        run(target="9", login=ServerLogin(running.url, "nobody", login))
    with pytest.raises(ServerError, match="cannot be reached"):
        run(target="9", login=ServerLogin("http://127.0.0.1:1", "bob", login))
    with pytest.raises(UsageError, match="no address"):
        run(target="9", login=ServerLogin("127.0.0.1", "bob", login))
    with pytest.raises(UsageError, match="--password-file"):
        run(target="9", login=ServerLogin(running.url, password_file=tmp_path / "none"))


def test_password_files(tmp_path):
    path = tmp_path / "login"
    path.write_text("operator abc\nadmin def\n")
    assert login_from_file(path, "admin") == "def"
    with pytest.raises(UsageError, match="no password for 'eve'"):
        login_from_file(path, "eve")


@each(
    ("text", "expected"),
    [("9", (9.0, 0.0)), ("9.5,-0.25", (9.5, -0.25)), (" 8 , 1 ", (8.0, 1.0))],
)
def test_targets(text, expected):
    assert parse_target(text) == expected


@each("text", ["", "x", "1,2,3", "nan", "inf,0", "9,", "9;1"])
def test_bad_targets(text):
    with pytest.raises(UsageError, match="RANGE"):
        parse_target(text)


def test_a_client_that_is_not_a_server_says_so(running):
    with pytest.raises(ServerError):
        ThrowClient(running.url + "/nothing", "bob", PASSWORD).__enter__()
