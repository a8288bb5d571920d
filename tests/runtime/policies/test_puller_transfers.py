"""What is asked for while a version is being transferred: rollbacks at the machine and by the server."""

import threading

import pytest

from machine.conventions import Mode
from machine.messages import EventKind
from runtime.policies import download
from runtime.policies.puller import ROLLBACK_FILE, PolicyPuller
from runtime.policies.slots import INSTALLED, PolicySlots
from runtime.records.log_upload import UploadTarget
from tests.runtime.policies.policy_server import policy_server
from tests.runtime.quick_policy import write_policy
from tests.waiting import wait_for


@pytest.fixture
def server():
    with policy_server() as found:
        yield found
        found.may_answer.set()


@pytest.fixture
def versions(tmp_path):
    for name, move_rad in (("old-2d", 0.2), ("new-2d", 0.3)):
        write_policy(tmp_path / name, Mode.PLANAR, move_rad)
    return tmp_path / "old-2d", tmp_path / "new-2d"


@pytest.fixture
def slots(tmp_path):
    return PolicySlots(tmp_path / "slots")


@pytest.fixture
def offers():
    return []


@pytest.fixture
def refusals():
    """Of the offers, in their order."""
    return []


@pytest.fixture
def rollbacks():
    """Whether each offer is one."""
    return []


@pytest.fixture
def puller(server, slots, offers, refusals, rollbacks, tmp_path, monkeypatch):
    """Longer than the test: only an answer, or what does not wait for it, lets it go on."""
    monkeypatch.setattr(download, "TIMEOUT_S", 600.0)

    def send(_, body):
        offers.append((body["policy_sha256"], body["deployment_count"]))
        rollbacks.append(body["is_rollback"])
        refusals.append(body["refusal"])
        return True

    found = PolicyPuller(tmp_path / "slots", UploadTarget(server.url, "m001", "token"), send)
    yield found
    server.may_answer.set()
    found.close()


def switched(puller, slot, count, is_rollback=False):
    data = {"mode": "2d", "policy_sha256": "c" * 64, "slot": slot, "deployment_count": count}
    data["is_rollback"] = is_rollback
    puller.take_event(EventKind.POLICY_SWITCHED, data)


def test_a_rollback_at_the_machine_does_not_wait_for_a_transfer_and_ends_the_deployment(
    server, versions, slots, offers, refusals, puller, tmp_path
):
    slots.switch(Mode.PLANAR, "a" * 64, 1)
    new = server.want(versions[1], 2)
    server.may_answer.clear()
    puller.start()
    wait_for(lambda: server.ranges)
    (tmp_path / "slots" / ROLLBACK_FILE).write_text('{"mode": "2d", "policy_sha256": ""}')
    wait_for(lambda: offers)
    assert offers[0] == (INSTALLED, None)
    switched(puller, INSTALLED, None, is_rollback=True)
    # Whoever asked for the version before is told.
    server.may_answer.set()
    wait_for(lambda: (new, 2) in offers)
    assert "rolled back at the machine" in refusals[offers.index((new, 2))]
    refused(puller, new, 2)
    assert slots.of(Mode.PLANAR).current == INSTALLED
    # Asked for after the rollback, it is wanted.
    server.want(versions[1], 3)
    wait_for(lambda: (new, 3) in offers)
    assert refusals[offers.index((new, 3))] == ""


def test_a_rollback_with_the_machine_off_ends_what_was_asked_for_before(
    server, versions, slots, offers, refusals, puller
):
    slots.switch(Mode.PLANAR, "a" * 64, 1)
    new = server.want(versions[1], 2)
    slots.roll_back(Mode.PLANAR)
    puller.poll()
    assert offers == [(new, 2)]
    assert "deploy again" in refusals[0]
    assert server.ranges == []  # nothing is fetched for it
    # To the version that it went back to, no person objects.
    slots.switch(Mode.PLANAR, new, 2)
    slots.switch(Mode.PLANAR, "a" * 64, 2)
    server.want(versions[1], 3)
    slots.roll_back(Mode.PLANAR)
    assert slots.of(Mode.PLANAR).current == new
    puller.poll()
    puller.poll()
    assert (offers[-1], refusals[-1]) == ((new, 3), "")


def test_a_rollback_by_the_server_is_offered_as_one(server, versions, rollbacks, puller):
    for count, is_rollback in ((1, False), (2, True)):
        server.want(versions[0], count, is_rollback=is_rollback)
        puller.poll()
        puller.poll()
    assert rollbacks == [False, True]


def test_nothing_of_the_server_is_offered_while_a_rollback_waits(
    server, versions, slots, offers, puller, tmp_path
):
    slots.switch(Mode.PLANAR, "a" * 64, 1)
    server.want(versions[1], 2)
    request = tmp_path / "slots" / ROLLBACK_FILE
    request.write_text('{"mode": "2d", "policy_sha256": ""}')
    puller.poll()
    assert offers == []
    request.unlink()
    puller.poll()
    puller.poll()
    assert [count for _, count in offers] == [2]


def refused(puller, policy_sha256, count):
    data = {
        "mode": "2d",
        "policy_sha256": policy_sha256,
        "slot": policy_sha256,
        "deployment_count": count,
        "is_removed": False,
    }
    puller.take_event(EventKind.POLICY_REFUSED, data)


def test_a_version_that_is_taken_back_during_its_transfer_is_never_offered(
    server, versions, slots, offers, puller
):
    server.want(versions[1], 2)
    server.may_answer.clear()
    polling = threading.Thread(target=puller.poll)
    polling.start()
    wait_for(lambda: server.ranges)
    old = server.want(versions[0], 3)
    server.may_answer.set()
    polling.join()
    assert offers == []
    puller.poll()
    puller.poll()
    assert offers == [(old, 3)]
    switched(puller, old, 3)
    puller.poll()
    assert offers == [(old, 3)]
    assert slots.of(Mode.PLANAR).current == old
