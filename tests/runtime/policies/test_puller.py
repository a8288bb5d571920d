"""Rollbacks at the machine and what its control process answers: nothing is forgotten in between."""

import pytest

from cli.main import main
from machine.conventions import Mode
from machine.errors import UsageError
from machine.messages import EventKind
from runtime.policies import puller as puller_module
from runtime.policies.puller import ROLLBACK_FILE, PolicyPuller, RollbackRequest
from runtime.policies.slots import INSTALLED, PolicySlots

NEW = "a" * 64


class Link:
    """A puller whose offers go to a list, as after each start of the link process."""

    def __init__(self, folder) -> None:
        self.folder, self.offers, self.is_up = folder, [], True
        self.start()

    def start(self):
        self.puller = PolicyPuller(self.folder, None, self._send)

    def _send(self, kind, body):
        self.offers.append(body)
        return self.is_up

    def look(self):
        self.puller._look_for_rollback()

    def answer(self, kind):
        data = {
            "mode": "2d",
            "policy_sha256": "b" * 64,
            "slot": self.offers[-1]["policy_sha256"],
            "is_rollback": self.offers[-1]["is_rollback"],
            "deployment_count": None,
            "is_removed": False,
        }
        self.puller.take_event(kind, data)


@pytest.fixture
def slots(tmp_path):
    found = PolicySlots(tmp_path)
    found.switch(Mode.PLANAR, NEW)
    return found


@pytest.fixture
def link(tmp_path, slots):
    request = RollbackRequest(mode=Mode.PLANAR, policy_sha256=INSTALLED)
    (tmp_path / ROLLBACK_FILE).write_text(request.model_dump_json())
    return Link(tmp_path)


def test_a_rollback_whose_offer_died_with_the_processes_is_offered_again(link, slots, tmp_path):
    link.look()
    link.look()
    assert [offer["policy_sha256"] for offer in link.offers] == [INSTALLED]
    link.start()  # control had not switched when both died
    link.look()
    assert len(link.offers) == 2
    link.answer(EventKind.POLICY_SWITCHED)
    assert slots.of(Mode.PLANAR).current == INSTALLED
    link.look()
    assert not (tmp_path / ROLLBACK_FILE).exists()
    assert len(link.offers) == 2
    with pytest.raises(UsageError, match="policy aaaaaaaaaaaa was rolled back"):
        slots.previous(Mode.PLANAR)


def test_a_rollback_that_was_done_when_the_processes_died_is_not_done_again(link, slots, tmp_path):
    link.look()
    link.answer(EventKind.POLICY_SWITCHED)
    link.start()
    link.look()
    assert (len(link.offers), slots.of(Mode.PLANAR).current) == (1, INSTALLED)
    assert not (tmp_path / ROLLBACK_FILE).exists()


def test_a_rollback_that_control_refuses_is_over_and_one_it_has_not_heard_goes_on(
    link, slots, tmp_path, monkeypatch
):
    monkeypatch.setattr(puller_module, "OFFER_PERIOD_S", 0.0)
    link.is_up = False
    link.look()
    link.look()
    assert len(link.offers) == 2
    link.answer(EventKind.POLICY_REFUSED)
    link.look()
    assert (len(link.offers), slots.of(Mode.PLANAR).current) == (2, NEW)
    assert not (tmp_path / ROLLBACK_FILE).exists()


def test_a_rollback_of_a_machine_that_is_off_takes_the_place_of_one_that_waits(tmp_path, capsys):
    (tmp_path / "machine.lock").touch()
    slots = PolicySlots(tmp_path / "policies")
    slots.switch(Mode.PLANAR, NEW)
    waits = tmp_path / "policies" / ROLLBACK_FILE
    waits.write_text(RollbackRequest(mode=Mode.PLANAR, policy_sha256=NEW).model_dump_json())
    assert main(["rollback", "--data", str(tmp_path), "--mode", "2d"]) == 0
    assert slots.of(Mode.PLANAR).current == INSTALLED
    assert not waits.exists()
    assert "the installed policy" in capsys.readouterr().out
    assert main(["rollback", "--data", str(tmp_path), "--mode", "2d"]) == 1
    said = capsys.readouterr().err
    assert "no version before the installed policy on this machine" in said
    assert f"policy {NEW[:12]} was rolled back; deploy" in said
    assert slots.of(Mode.PLANAR).current == INSTALLED
