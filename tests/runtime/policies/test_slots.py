import json
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from machine.conventions import Mode
from machine.errors import PolicyError, UsageError
from machine.policy_approval import (
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    revoke_key,
    rotate_key,
    sign,
    sign_list,
)
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, file_sha256, read_policy
from machine.spec import load_spec
from runtime.policies import slots as module
from runtime.policies.on_board import OnBoardPolicies
from runtime.policies.slots import INSTALLED, NO_FIRST_KEY, PolicySlots
from tests.cases import each
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


def test_no_rollback_leads_to_a_version_that_was_rolled_back_until_it_is_deployed_anew(tmp_path):
    slots = PolicySlots(tmp_path)
    slots.switch(Mode.PLANAR, A, 1)
    slots.switch(Mode.PLANAR, B, 2)
    assert slots.roll_back(Mode.PLANAR) == A
    with pytest.raises(
        UsageError, match=r"before policy a{12} .*policy b{12} was rolled back; deploy"
    ):
        PolicySlots(tmp_path).roll_back(Mode.PLANAR)
    assert PolicySlots(tmp_path).of(Mode.PLANAR).current == A
    assert slots.rolled_back_from() == {"2d": B}
    # The version in use deployed again is no other version.
    slots.switch(Mode.PLANAR, A, 3)
    assert slots.rolled_back_from() == {}
    with pytest.raises(UsageError, match="was rolled back"):
        slots.roll_back(Mode.PLANAR)
    slots.switch(Mode.PLANAR, B, 4)
    assert slots.roll_back(Mode.PLANAR) == A
    # By the server.
    slots.switch(Mode.PLANAR, INSTALLED, 5, is_rollback=True)
    with pytest.raises(UsageError, match=r"before the installed policy .*policy a{12} was rolled"):
        slots.roll_back(Mode.PLANAR)


def test_slots_of_older_software_go_back_as_before(tmp_path):
    text = json.dumps({"2d": {"current": A, "previous": B, "rolled_back_s": 1.0}})
    (tmp_path / "slots.json").write_text(text)
    assert PolicySlots(tmp_path).roll_back(Mode.PLANAR) == B


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


@each(
    "text",
    ["", "{", '{"2d": {"current": "../../etc"}}', '{"4d": {}}', '{"2d": 3}', "\x00\xff"],
    copied="tmp_path",
)
def test_damaged_slots_are_those_of_a_machine_that_never_switched(tmp_path, text):
    (tmp_path / "slots.json").write_text(text, encoding="latin-1")
    assert PolicySlots(tmp_path).of(Mode.PLANAR).current == INSTALLED


def board_in(folder):
    installed = write_policies(folder / "installed")
    return OnBoardPolicies(PolicySlots(folder / "slots"), installed, load_spec())


@pytest.fixture
def board(tmp_path):
    return board_in(tmp_path)


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
    # One that a person took out of use is the last to be tried.
    slots.roll_back(Mode.PLANAR)
    slots.switch(Mode.PLANAR, second_sha256, is_rollback=True)
    assert board.start(Mode.PLANAR).card.policy_id == "quick-2d"
    slots.switch(Mode.PLANAR, first_sha256)
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
        approve(
            read_policy(folder), key, approved_by="eve", approved_utc="2026-03-01T10:14:00+00:00"
        )
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


def change_network(folder, change):
    """Another network under a card that names its hash, as a careless exporter writes it."""
    model = onnx.load(str(folder / POLICY_FILE))
    change(model, {one.name: one for one in model.graph.initializer})
    (folder / POLICY_FILE).write_bytes(model.SerializeToString())
    change_card(folder, policy_sha256=file_sha256(folder / POLICY_FILE))


def change_card(folder, **changes):
    card = json.loads((folder / CARD_FILE).read_text())
    (folder / CARD_FILE).write_text(json.dumps(card | changes))


def permuted_inputs(model, tensors):
    weights = numpy_helper.to_array(tensors["W"])
    tensors["W"].CopyFrom(numpy_helper.from_array(np.roll(weights, 1, axis=0).copy(), "W"))


def rescaled_outputs(model, tensors):
    bias = numpy_helper.to_array(tensors["b"])
    tensors["b"].CopyFrom(numpy_helper.from_array((0.9 * bias).astype(np.float32), "b"))


def external_data(model, tensors):
    tensors["W"].external_data.add(key="location", value="weights.bin")


def custom_operator(model, tensors):
    model.graph.node[-1].domain = "com.example"


BEFORE_APPROVAL = {
    "permuted inputs": (lambda f: change_network(f, permuted_inputs), "golden observation"),
    "rescaled outputs": (lambda f: change_network(f, rescaled_outputs), "golden observation"),
    "external data": (lambda f: change_network(f, external_data), "lies outside of the file"),
    "custom operator": (lambda f: change_network(f, custom_operator), "uses operator"),
    "other machine": (lambda f: change_card(f, model_sha256="0" * 64), "was trained for model"),
    "other rate": (lambda f: change_card(f, control_rate_hz=50.0), "50 Hz"),
}
AFTER_APPROVAL = {
    "truncated": (
        lambda f: (f / POLICY_FILE).write_bytes((f / POLICY_FILE).read_bytes()[:-20]),
        "was changed or cut off",
    ),
    "wrong hash": (lambda f: change_card(f, policy_sha256="0" * 64), "its card says 000000"),
    "altered card": (lambda f: change_card(f, target_range_max_m=12.0), "was altered after its"),
    "altered vectors": (
        lambda f: (f / GOLDEN_FILE).write_text((f / GOLDEN_FILE).read_text() + " "),
        "golden vectors of policy .* were altered",
    ),
    "no vectors": (lambda f: (f / GOLDEN_FILE).unlink(), "golden vectors of policy .* are missing"),
    "other mode": (None, "is approved for mode 2d, not for 3d"),
    "revoked key": (None, "which was revoked"),
}


def refuses(board, sha256, words, mode=Mode.PLANAR):
    with pytest.raises(PolicyError, match=words):
        board.load(mode, sha256)


@each("case", BEFORE_APPROVAL, copied="tmp_path")
def test_the_machine_refuses_what_even_its_site_has_signed(tmp_path, case):
    """The site's server may be wrong or taken over: the machine checks the network itself."""
    change, words = BEFORE_APPROVAL[case]
    board = board_in(tmp_path)
    slots = PolicySlots(tmp_path / "slots")
    folder, _ = put(tmp_path, "first-2d", 0.2)
    change(folder)
    sha256 = read_policy(folder).card.policy_sha256
    folder = folder.rename(folder.with_name(sha256))
    slots.keep_trust(trust_of(folder))
    refuses(board, sha256, words)


@each("case", AFTER_APPROVAL, copied="tmp_path")
def test_the_machine_refuses_what_was_changed_after_it_was_signed(tmp_path, case):
    change, words = AFTER_APPROVAL[case]
    board = board_in(tmp_path)
    slots = PolicySlots(tmp_path / "slots")
    folder, sha256 = put(tmp_path, "first-2d", 0.2)
    first = trust_of(folder)
    slots.keep_trust(first)
    board.load(Mode.PLANAR, sha256)
    if change is not None:
        change(folder)
    elif case == "revoked key":
        new = new_private_key()
        rotated = rotate_key(first, KEY, new, rotated_utc="2026-03-02T00:00:00+00:00")
        last = revoke_key(rotated, public_key(KEY).key_id, new)
        slots.keep_trust(last)
        # The approval was signed anew and holds; the old one, brought back by the new key, does not.
        board.load(Mode.PLANAR, sha256)
        slots.keep_trust(sign_list(last.model_copy(update={"approvals": first.approvals}), new))
    refuses(board, sha256, words, Mode.SPATIAL if case == "other mode" else Mode.PLANAR)


def test_a_machine_that_was_away_follows_two_changes_of_the_key(tmp_path, board):
    slots = PolicySlots(tmp_path / "slots")
    folder, sha256 = put(tmp_path, "first-2d", 0.2)
    trust, key = trust_of(folder), KEY
    slots.keep_trust(trust)
    for day in ("02", "03"):
        old, key = key, new_private_key()
        trust = rotate_key(trust, old, key, rotated_utc=f"2026-03-{day}T00:00:00+00:00")
    assert slots.keep_trust(trust)
    assert board.load(Mode.PLANAR, sha256).card.policy_id == "first-2d"


def test_a_machine_is_bound_by_the_key_that_a_person_named(tmp_path, board):
    folder, sha256 = put(tmp_path, "first-2d", 0.2)
    first, new = trust_of(folder), new_private_key()
    named = first.signed_by
    slots = PolicySlots(tmp_path / "slots")
    with pytest.raises(PolicyError, match="takes no key by itself"):
        slots.keep_trust(first, NO_FIRST_KEY)
    with pytest.raises(PolicyError, match=f"{'0' * 16}, which site yard does not have"):
        slots.keep_trust(first, "0" * 16)
    # Another key under the name of the one that was named.
    forged = public_key(new).model_copy(update={"key_id": named})
    unsigned = first.model_copy(update={"keys": (forged,), "signature": ""})
    signed = unsigned.model_copy(update={"signature": sign(new, unsigned.signed_bytes())})
    for key in (named, None):
        with pytest.raises(PolicyError, match=r"names key .* and holds another"):
            slots.keep_trust(signed, key)
    assert slots.trust() is None
    # The named key has passed its trust on since: the list of its successor is taken.
    rotated = rotate_key(first, KEY, new, rotated_utc="2026-03-02T00:00:00+00:00")
    revoked = revoke_key(rotated, named, new)
    with pytest.raises(PolicyError, match="was revoked"):
        slots.keep_trust(revoked, named)
    assert slots.keep_trust(rotated, named)
    assert board.load(Mode.PLANAR, sha256).card.policy_id == "first-2d"
