"""Accounts from the command line, beside a server that runs."""

from pathlib import Path

import httpx
import pytest

from cli.main import main
from server.store.database import upgrade
from tests.server.server_bench import PASSWORD, make_settings, running_server, wait_for


@pytest.fixture
def data(tmp_path: Path) -> Path:
    upgrade(f"sqlite:///{tmp_path / 'downrange.db'}")
    return tmp_path


@pytest.fixture
def secret(tmp_path: Path) -> str:
    path = tmp_path / "password"
    path.write_text(f"{PASSWORD}\n")
    return str(path)


def user(data: Path, *arguments: str) -> int:
    return main(["user", *arguments, "--data", str(data)])


def listed(data: Path, capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    capsys.readouterr()
    assert user(data, "list") == 0
    return [line.split() for line in capsys.readouterr().out.splitlines()]


def test_people_come_change_and_go(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert user(data, "add", "root", "--role", "admin") == 0
    assert "password " in capsys.readouterr().out
    assert user(data, "add", "eve", "--role", "viewer") == 0
    assert user(data, "role", "eve", "engineer") == 0
    assert listed(data, capsys) == [["eve", "engineer"], ["root", "admin"]]
    assert user(data, "disable", "eve") == 0
    assert listed(data, capsys)[0] == ["eve", "engineer", "disabled"]
    assert user(data, "enable", "eve") == 0
    assert listed(data, capsys)[0] == ["eve", "engineer"]


REFUSED = (
    (("add", "root", "--role", "viewer"), "already"),
    (("add", "Eve Smith", "--role", "viewer"), "is no name"),
    (("disable", "root"), "last admin"),
    (("role", "root", "operator"), "last admin"),
    (("role", "nobody", "operator"), "there is no nobody"),
    (("password", "nobody"), "there is no nobody"),
    (("password", "root", "--password-file", "/nowhere"), "cannot be read"),
)


def test_what_cannot_be_is_refused_in_words(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert user(data, "add", "root", "--role", "admin") == 0
    for arguments, words in REFUSED:
        assert user(data, *arguments) == 1, arguments
        assert words in capsys.readouterr().err
        assert listed(data, capsys) == [["root", "admin"]]


def test_short_passwords_are_refused(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = tmp_path / "short"
    short.write_text("secret")
    assert user(data, "add", "eve", "--role", "viewer", "--password-file", str(short)) == 1
    assert "12 are needed" in capsys.readouterr().err


def test_changes_count_in_a_server_that_runs(
    tmp_path: Path, swing_policies: Path, secret: str
) -> None:
    data = tmp_path / "data"
    with running_server(make_settings(data, swing_policies)) as running:
        assert user(data, "add", "eve", "--role", "viewer", "--password-file", secret) == 0

        def status(client: httpx.Client) -> int:
            return client.get("/audit").status_code

        with running.client("eve") as eve:
            assert status(eve) == 403
            assert user(data, "role", "eve", "supervisor") == 0
            assert status(eve) == 200
            assert user(data, "disable", "eve") == 0
            wait_for(lambda: status(eve) == 401)
        verdict = running.parts.audit.verify()
        assert verdict.is_intact, verdict.problem
