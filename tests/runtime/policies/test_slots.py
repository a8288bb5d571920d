import json
from pathlib import Path

import pytest

from machine.conventions import Mode
from machine.errors import PolicyError, UsageError
from machine.policy_approval import (
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    sign_list,
)
from machine.spec import load_spec
from runtime.policies import slots as module
from runtime.policies.on_board import OnBoardPolicies
from runtime.policies.slots import INSTALLED, PolicySlots
from tests.runtime.quick_policy import write_policies, write_policy

KEY = new_private_key()
A, B = "a" * 64, "b" * 64


def test_two_slots_a_mode_and_back(tmp_path):
    slots = PolicySlots(tmp_path)
    with pytest.raises(UsageError, match="no version before"):
        slots.roll_back(Mode.PLANAR)
    slots.switch(Mode.PLANAR, A, 1)
    slots.switch(Mode.PLANAR, A, 1)
    found = PolicySlots(tmp_path).of(Mode.PLANAR)
    assert (found.current, found.previous, found.deployment_count) == (A, INSTALLED, 1)
    assert slots.roll_back(Mode.PLANAR) == INSTALLED
    slots.switch(Mode.PLANAR, B, 3)
    slots.note(Mode.PLANAR, 2)
    found = PolicySlots(tmp_path).of(Mode.PLANAR)
    assert (found.current, found.previous, found.deployment_count) == (B, INSTALLED, 3)
    assert PolicySlots(tmp_path).of(Mode.SPATIAL).current == INSTALLED


@pytest.mark.parametrize("step", ["write", "replace"])
def test_a_switch_that_is_cut_off_leaves_the_slots_as_they_were(tmp_path, monkeypatch, step):
    slots = PolicySlots(tmp_path)
    slots.switch(Mode.PLANAR, A, 1)
    before = (tmp_path / "slots.json").read_bytes()

    def cut(*_):
        raise OSError("the power went")

    with monkeypatch.context() as patch:
        if step == "write":
            patch.setattr(module.os, "fsync", cut)
        else:
            patch.setattr(Path, "replace", cut)
        with pytest.raises(OSError, match="power"):
            slots.switch(Mode.PLANAR, B, 2)
    assert (tmp_path / "slots.json").read_bytes() == before
    assert PolicySlots(tmp_path).of(Mode.PLANAR).current == A
    slots.switch(Mode.PLANAR, B, 2)
    assert PolicySlots(tmp_path).of(Mode.PLANAR).current == B


@pytest.mark.parametrize(
    "text", ["", "{", '{"2d": {"current": "../../etc"}}', '{"4d": {}}', '{"2d": 3}', "\x00\xff"]
)
def test_damaged_slots_are_those_of_a_machine_that_never_switched(tmp_path, text):
    (tmp_path / "slots.json").write_text(text, encoding="latin-1")
    assert PolicySlots(tmp_path).of(Mode.PLANAR).current == INSTALLED


@pytest.fixture
def board(tmp_path):
    installed = write_policies(tmp_path / "installed")
    return OnBoardPolicies(PolicySlots(tmp_path / "slots"), installed, load_spec())


def put(tmp_path, name, move_rad):
    sha256 = write_policy(tmp_path / name, Mode.PLANAR, move_rad)
    return PolicySlots(tmp_path / "slots").add(tmp_path / name, sha256), sha256


def test_a_version_that_cannot_be_used_gives_way_to_the_one_before_and_that_to_the_installed(
    tmp_path, board
):
    slots = PolicySlots(tmp_path / "slots")
    first, first_sha256 = put(tmp_path, "first-2d", 0.2)
    second, second_sha256 = put(tmp_path, "second-2d", 0.3)
    slots.switch(Mode.PLANAR, first_sha256)
    slots.switch(Mode.PLANAR, second_sha256)
    assert board.start(Mode.PLANAR).card.policy_id == "second-2d"
    (second / "policy.onnx").write_bytes(b"cut off")
    assert board.start(Mode.PLANAR).card.policy_id == "first-2d"
    (first / "card.json").unlink()
    assert board.start(Mode.PLANAR).card.policy_id == "quick-2d"
    assert board.start(Mode.SPATIAL).card.policy_id == "quick-3d"


def test_a_folder_that_holds_another_version_than_its_name_says_is_refused(tmp_path, board):
    folder, _ = put(tmp_path, "first-2d", 0.2)
    folder.rename(folder.with_name(B))
    with pytest.raises(PolicyError, match="holds first-2d"):
        board.load(Mode.PLANAR, B)
    with pytest.raises(PolicyError, match="is missing"):
        board.load(Mode.PLANAR, A)


def test_versions_that_no_slot_names_are_removed(tmp_path):
    slots = PolicySlots(tmp_path / "slots")
    kept = []
    for number in range(4):
        _, sha256 = put(tmp_path, f"version-{number}", 0.1 + 0.05 * number)
        slots.switch(Mode.PLANAR, sha256)
        kept.append(sha256)
    slots.remove_unused(frozenset({kept[0]}))
    found = {path.name for path in (tmp_path / "slots" / "versions").iterdir()}
    assert found == {kept[0], kept[2], kept[3]}
    assert json.loads((tmp_path / "slots" / "slots.json").read_text())["2d"]["current"] == kept[3]


def trust_of(*folders, key=KEY, serial_count=1):
    approvals = tuple(
        approve(folder, key, approved_by="eve", approved_utc="2026-03-01T10:14:00+00:00")
        for folder in folders
    )
    unsigned = SiteTrust(
        site="yard",
        keys=(public_key(key),),
        approvals=approvals,
        serial_count=serial_count - 1,
    )
    return sign_list(unsigned, key)


def test_a_bound_machine_loads_nothing_that_is_not_approved(tmp_path, board):
    slots = PolicySlots(tmp_path / "slots")
    first, first_sha256 = put(tmp_path, "first-2d", 0.2)
    slots.switch(Mode.PLANAR, first_sha256)
    assert slots.keep_trust(trust_of(first))
    assert board.start(Mode.PLANAR).card.policy_id == "first-2d"
    with pytest.raises(PolicyError, match=r"quick-3d .* is not approved by site yard"):
        board.start(Mode.SPATIAL)
    # Approvals that are taken back lead to a version that is approved.
    later = trust_of(tmp_path / "installed" / "quick-2d", serial_count=2)
    assert slots.keep_trust(later)
    assert not slots.keep_trust(later)
    assert board.load(Mode.PLANAR, None).card.policy_id == "quick-2d"
    with pytest.raises(PolicyError, match="first-2d"):
        board.load(Mode.PLANAR, first_sha256)
    # An older list does not bring a withdrawn version back.
    with pytest.raises(PolicyError, match="list 1 of site yard is not newer than list 2"):
        slots.keep_trust(trust_of(first))
    with pytest.raises(PolicyError, match="first-2d"):
        board.load(Mode.PLANAR, first_sha256)


def test_other_keys_than_those_that_bound_the_machine_are_refused(tmp_path, board):
    slots = PolicySlots(tmp_path / "slots")
    installed = tmp_path / "installed" / "quick-2d"
    slots.keep_trust(trust_of(installed))
    with pytest.raises(PolicyError, match=r"which site yard does not have; .* remove .*site\.json"):
        slots.keep_trust(trust_of(installed, key=new_private_key(), serial_count=2))
    assert board.start(Mode.PLANAR).card.policy_id == "quick-2d"


def test_approvals_that_cannot_be_read_approve_nothing(tmp_path, board):
    slots = PolicySlots(tmp_path / "slots")
    slots.keep_trust(trust_of(tmp_path / "installed" / "quick-2d"))
    (tmp_path / "slots" / "site.json").write_text("{")
    with pytest.raises(PolicyError, match="cannot be read"):
        board.start(Mode.PLANAR)
