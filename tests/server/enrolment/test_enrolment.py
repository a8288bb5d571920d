"""Machines come and go while others work."""

from datetime import timedelta

import pytest
import zenoh

from cli.machine import warn_in_the_clear
from cli.main import main
from machine.messages import ThrowState
from runtime.enrolment.enrolment_file import read_enrolment
from runtime.link.zenoh_config import client_config
from server.clock import utc_now
from server.enrolment import enrolments as module
from server.enrolment.enrolments import Enrolments
from server.enrolment.router_renewal import RouterRenewal
from server.errors import ConflictError, NotSignedInError
from server.machines.machine_link import MachineLostError
from tests.cases import each
from tests.server.fake_machine import FakeMachine
from tests.server.machines.test_machine_link import load
from tests.server.server_bench import make_settings, wait_for

PASSED = {"name": "link", "is_passed": True, "detail": "answers"}


def add(client, **body):
    reply = client.post("/machines", json=body)
    assert reply.status_code == 201, reply.text
    return reply.json()


def claim(running, token):
    with running.client() as nobody:
        return nobody.post("/enrolments/claim", json={"token": token})


def test_a_machine_is_added_set_up_and_retired_while_another_is_connected(running, machine):
    lost = []
    running.parts.registry.on_lost.append(lost.append)
    with running.client("root") as root:
        added = add(root, machine_id="crane-9", name="By the gate")
        path = "/machines/crane-9"
        assert root.get(f"{path}/enrolment").json()["stage"] == "waiting"
        found = claim(running, added["token"]).json()
        assert found["connect"] == [running.settings.link_listen]
        assert claim(running, added["token"]).status_code == 401
        # The account is new: the router has to be opened anew before it lets the machine in.
        with connected(running, "crane-9", found["password"]):
            report = {"items": [PASSED, PASSED | {"name": "imu", "is_passed": False}]}
            bearer = {"Authorization": f"Bearer {found['password']}"}
            assert root.put(f"{path}/self-test", json=report).status_code == 401
            assert root.put(f"{path}/self-test", json=report, headers=bearer).status_code == 204
            view = root.get(f"{path}/enrolment").json()
            assert view["stage"] == "tested"
            assert [item["is_passed"] for item in view["self_test"]] == [True, False]
            assert running.parts.link.send(load("crane-9")).accepted
            refused = root.post(f"{path}/retire", json={"reason": "sold"})
            assert refused.json()["error"]["code"] == "machine_connected"
            assert root.post(f"{path}/enrolment").status_code == 409
        assert "m001" not in lost
        assert running.parts.registry.is_connected("m001")
        wait_for(lambda: not running.parts.registry.is_connected("crane-9"))
        assert root.post(f"{path}/retire", json={"reason": "sold"}).status_code == 204
        assert "crane-9" not in [row["machine_id"] for row in root.get("/machines").json()]
        assert root.get("/fleet/retired").json()[0]["machine_id"] == "crane-9"
        assert root.put(f"{path}/self-test", json=report, headers=bearer).status_code == 401
        assert root.post("/machines", json={"machine_id": "crane-9"}).status_code == 409
        assert root.get(f"{path}/life").json()["counts"]["throw_count"] == 0
        with pytest.raises(MachineLostError):
            running.parts.link.send(load("crane-9"))
        wait_for(lambda: not lets_in(running, "crane-9", found["password"]))
        assert running.parts.registry.is_connected("m001")
        assert "m001" not in lost


def lets_in(running, machine_id, password):
    """Whether the router still takes a password."""
    config = client_config(
        connect=[running.settings.link_listen], user=machine_id, password=password
    )
    try:
        zenoh.open(config).close()
    except zenoh.ZError:
        return False
    return True


def connected(running, machine_id, password):
    """A stand-in that is let in and connected."""
    opened = []

    def is_in():
        try:
            fake = FakeMachine(running.settings.link_listen, machine_id, password, {})
            fake.__enter__()
        except Exception:
            return False
        opened.append(fake)
        return True

    wait_for(is_in)
    wait_for(lambda: running.parts.registry.is_connected(machine_id))
    return _Opened(opened[0])


class _Opened:
    def __init__(self, fake):
        self.fake = fake

    def __enter__(self):
        return self.fake

    def __exit__(self, *_):
        self.fake.__exit__()


@pytest.fixture
def service(assembled):
    parts = assembled.parts
    parts.approvals.start()
    return parts.enrolments, assembled.session().actor


def test_a_mistake_at_the_machine_does_not_use_the_token_up(running, tmp_path, capsys):
    with running.client("root") as root:
        added = add(root, machine_id="crane-8")
        words = ["machine", "enrol", "--server", running.url, "--token", added["token"]]
        missing = str(tmp_path / "missing.json")
        assert main([*words, "--data", str(tmp_path / "data"), "--calibration", missing]) == 1
        assert f"--calibration {missing} does not exist" in capsys.readouterr().err
        assert root.get("/machines/crane-8/enrolment").json()["stage"] == "waiting"

        # A server that shows another key than the page did: the machine is not set up.
        assert added["site_key_id"] == running.parts.approvals.trust().signed_by
        data = tmp_path / "other"
        assert main([*words, "--data", str(data), "--site-key", "0" * 16]) == 1
        assert "key 0000000000000000, which site yard does not have" in capsys.readouterr().err
        assert read_enrolment(data) is None and not (data / "policies" / "site.json").exists()


@each(
    ("server", "is_warned"),
    [("http://127.0.0.1:8000", False), ("https://yard", False), ("http://yard:8000", True)],
)
def test_a_password_over_an_open_network_is_warned_of(capsys, server, is_warned):
    warn_in_the_clear(server)
    assert ("not encrypted" in capsys.readouterr().err) == is_warned


def test_a_token_is_void_when_it_is_used_replaced_late_or_its_machine_retired(
    service, assembled, monkeypatch
):
    enrolments, actor = service
    machine_id, first, _ = enrolments.add(None, "", actor)
    assert machine_id == "m001"
    second, _ = enrolments.issue(machine_id, actor)
    with pytest.raises(NotSignedInError):
        enrolments.claim(first, "", "")
    assert enrolments.claim(second, "10.0.0.7", "").machine_id == "m001"
    with pytest.raises(NotSignedInError):
        enrolments.claim(second, "", "")
    assert enrolments.view("m001").claimed_from == "10.0.0.7"
    other, token, _ = enrolments.add(None, "", actor)
    assert other == "m002"
    later = utc_now() + timedelta(seconds=module.TOKEN_S)
    with monkeypatch.context() as patch:
        patch.setattr(module, "utc_now", lambda: later)
        with pytest.raises(NotSignedInError):
            enrolments.claim(token, "", "")
        assert enrolments.view("m002").stage == "expired"
    assembled.parts.registry.retire("m002", "never came", actor)
    with pytest.raises(NotSignedInError):
        enrolments.claim(token, "", "")
    with pytest.raises(ConflictError):
        enrolments.issue("m002", actor)
    # More machines than accounts were made for: the next one gets a new account.
    third, token, _ = enrolments.add(None, "", actor)
    assert third == "m003"
    assert enrolments.claim(token, "", "").password == assembled.parts.registry.password("m003")


@each(
    ("listen", "address", "host", "expected"),
    [
        ("tcp/10.1.1.1:7447", None, "console:8000", "tcp/10.1.1.1:7447"),
        ("tcp/0.0.0.0:7447", None, "console.example:8000", "tcp/console.example:7447"),
        ("tcp/[::]:7447", None, "[fe80::1]:8000", "tcp/[fe80::1]:7447"),
        ("tcp/0.0.0.0:7447", "tls/router.example:7447", "console", "tls/router.example:7447"),
    ],
)
def test_machines_get_an_address_that_they_can_reach(tmp_path, listen, address, host, expected):
    settings = make_settings(tmp_path, tmp_path, link_listen=listen, link_address=address)
    assert Enrolments(None, None, None, None, settings).link_address(host) == expected


class _Known:
    def __init__(self, state):
        self.is_connected, self.state = True, self if state else None
        if state:
            self.state = type("State", (), {"state": state})()


@each("state", list(ThrowState))
def test_the_router_stays_open_while_a_machine_is_armed_or_throws(state):
    registry = type("Registry", (), {"all": lambda _: [_Known(state), _Known(None)]})()
    is_quiet = RouterRenewal(None, registry, None, dict).is_quiet()
    assert is_quiet == (state.value in ("disarmed", "stopped", "fault"))
