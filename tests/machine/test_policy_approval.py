import json

import pytest

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_approval import (
    Approval,
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    sign_list,
)
from machine.policy_card import CARD_FILE, POLICY_FILE, file_sha256, load_card
from tests.runtime.quick_policy import write_policy

KEY, OTHER_KEY = new_private_key(), new_private_key()


@pytest.fixture
def folder(tmp_path):
    write_policy(tmp_path / "quick-2d", Mode.PLANAR)
    return tmp_path / "quick-2d"


def signed(folder, key=KEY):
    return approve(folder, key, approved_by="eve", approved_utc="2026-03-01T10:14:00+00:00")


def trust(*approvals, **changes):
    keys = (public_key(KEY).model_copy(update=changes),)
    return SiteTrust(site="yard", keys=keys, approvals=approvals)


def test_an_approved_version_passes_also_after_a_trip_as_json(folder):
    approval = signed(folder)
    again = SiteTrust.model_validate_json(trust(approval).model_dump_json())
    assert again.check(folder, Mode.PLANAR) == approval


def test_what_is_not_approved_is_refused_with_the_reason(folder):
    approval = signed(folder)
    other = write_policy(folder.with_name("other-2d"), Mode.PLANAR, 0.3)
    cases = {
        "is not approved by site yard": trust(),
        "is not signed": trust(approval.model_copy(update={"signature": ""})),
        "which site yard does not have": trust(signed(folder, OTHER_KEY)),
        "which was revoked": trust(approval, is_revoked=True),
        "is approved for mode 2d, not for 3d": trust(approval),
        "is not approved by": trust(approval.model_copy(update={"policy_sha256": other})),
    }
    for words, site in cases.items():
        mode = Mode.SPATIAL if "not for 3d" in words else Mode.PLANAR
        with pytest.raises(PolicyError, match=words):
            site.check(folder, mode)


@pytest.mark.parametrize(
    "change",
    [
        {"card_sha256": "0" * 64},
        {"mode": Mode.SPATIAL},
        {"model_sha256": "0" * 64},
        {"approved_by": "mallory"},
        {"approved_utc": "2027-01-01T00:00:00+00:00"},
        {"signature": "AAAA"},
        {"signature": "no base64!"},
    ],
)
def test_no_word_of_an_approval_can_be_changed(folder, change):
    with pytest.raises(PolicyError, match="is not that of key"):
        trust(signed(folder).model_copy(update=change)).check(folder, Mode.PLANAR)


def test_an_altered_card_or_network_is_refused(folder):
    site = trust(signed(folder))
    card = json.loads((folder / CARD_FILE).read_text())
    card["target_range_max_m"] = 30.0
    (folder / CARD_FILE).write_text(json.dumps(card))
    with pytest.raises(PolicyError, match=r"card .* was altered after its approval"):
        site.check(folder, Mode.PLANAR)
    (folder / POLICY_FILE).write_bytes(b"another network")
    with pytest.raises(PolicyError, match="the file was changed"):
        site.check(folder, Mode.PLANAR)
    # With a card that says so, it is another version.
    renamed = load_card_with(folder, file_sha256(folder / POLICY_FILE))
    assert renamed.policy_sha256 == file_sha256(folder / POLICY_FILE)
    with pytest.raises(PolicyError, match="is not approved"):
        site.check(folder, Mode.PLANAR)


def load_card_with(folder, sha256):
    card = json.loads((folder / CARD_FILE).read_text())
    (folder / CARD_FILE).write_text(json.dumps(card | {"policy_sha256": sha256}))
    return load_card(folder)


def test_the_signature_is_over_canonical_json(folder):
    approval = signed(folder)
    body = json.loads(approval.signed_bytes())
    assert "signature" not in body
    assert list(body) == sorted(body)
    shuffled = dict(reversed(json.loads(approval.model_dump_json()).items()))
    assert Approval.model_validate(shuffled).signed_bytes() == approval.signed_bytes()


def test_a_new_key_comes_by_a_list_that_the_old_one_signed(folder):
    known = sign_list(trust(signed(folder)), KEY)
    old, new = public_key(KEY), public_key(OTHER_KEY)
    keys = (old.model_copy(update={"is_revoked": True}), new)
    approvals = (signed(folder, OTHER_KEY),)
    rotated = sign_list(known.model_copy(update={"keys": keys, "approvals": approvals}), KEY)
    rotated.require_successor_of(known)
    rotated.check(folder, Mode.PLANAR)
    # From then on the old key signs nothing, and the new one does.
    with pytest.raises(PolicyError, match="which was revoked"):
        sign_list(rotated, KEY).require_successor_of(rotated)
    sign_list(rotated, OTHER_KEY).require_successor_of(rotated)
    # A machine that missed the change learns it by the list that the old key signed, not by a later one.
    with pytest.raises(PolicyError, match="does not have"):
        sign_list(rotated, OTHER_KEY).require_successor_of(known)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"site": "other"}, "bound to site yard"),
        ({"approvals": ()}, "is not that of key"),
        ({"serial_count": 9}, "is not that of key"),
        ({"signature": ""}, "is not signed"),
        ({"signed_by": "0" * 16}, "does not have"),
    ],
)
def test_no_word_of_a_list_can_be_changed(folder, change, words):
    known = sign_list(trust(), KEY)
    following = sign_list(trust(signed(folder)).model_copy(update={"serial_count": 1}), KEY)
    following.require_successor_of(known)
    following.require_successor_of(None)
    with pytest.raises(PolicyError, match=words):
        following.model_copy(update=change).require_successor_of(known)
    with pytest.raises(PolicyError, match="is not newer"):
        known.require_successor_of(following)
