import base64
import json

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_approval import (
    Approval,
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    revoke_key,
    rotate_key,
    sign_list,
)
from machine.policy_card import (
    CARD_FILE,
    GOLDEN_FILE,
    POLICY_FILE,
    file_sha256,
    load_card,
    read_policy,
)
from tests.cases import each
from tests.runtime.quick_policy import write_policy

KEY, OTHER_KEY, THIRD_KEY, EVIL_KEY = (new_private_key() for _ in range(4))


@pytest.fixture
def folder(tmp_path):
    write_policy(tmp_path / "quick-2d", Mode.PLANAR)
    return tmp_path / "quick-2d"


def signed(folder, key=KEY):
    return approve(
        read_policy(folder), key, approved_by="eve", approved_utc="2026-03-01T10:14:00+00:00"
    )


def trust(*approvals, **changes):
    keys = (public_key(KEY).model_copy(update=changes),)
    return SiteTrust(site="yard", keys=keys, approvals=approvals)


def test_an_approved_version_passes_also_after_a_trip_as_json(folder):
    approval = signed(folder)
    again = SiteTrust.model_validate_json(trust(approval).model_dump_json())
    assert again.check(read_policy(folder), Mode.PLANAR) == approval


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
            site.check(read_policy(folder), mode)


@each(
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
        trust(signed(folder).model_copy(update=change)).check(read_policy(folder), Mode.PLANAR)


def test_an_altered_card_or_network_is_refused(folder):
    site = trust(signed(folder))
    card = json.loads((folder / CARD_FILE).read_text())
    card["target_range_max_m"] = 30.0
    (folder / CARD_FILE).write_text(json.dumps(card))
    with pytest.raises(PolicyError, match=r"card .* was altered after its approval"):
        site.check(read_policy(folder), Mode.PLANAR)
    (folder / POLICY_FILE).write_bytes(b"another network")
    with pytest.raises(PolicyError, match="the file was changed"):
        site.check(read_policy(folder), Mode.PLANAR)
    # With a card that says so, it is another version.
    renamed = load_card_with(folder, file_sha256(folder / POLICY_FILE))
    assert renamed.policy_sha256 == file_sha256(folder / POLICY_FILE)
    with pytest.raises(PolicyError, match="is not approved"):
        site.check(read_policy(folder), Mode.PLANAR)


def load_card_with(folder, sha256):
    card = json.loads((folder / CARD_FILE).read_text())
    (folder / CARD_FILE).write_text(json.dumps(card | {"policy_sha256": sha256}))
    return load_card(folder)


def test_altered_or_missing_golden_vectors_are_refused(folder):
    site = trust(signed(folder))
    text = (folder / GOLDEN_FILE).read_text()
    (folder / GOLDEN_FILE).write_text(text.replace('"tolerance": 0.0001', '"tolerance": 0.001'))
    with pytest.raises(PolicyError, match=r"golden vectors of policy quick-2d .* were altered"):
        site.check(read_policy(folder), Mode.PLANAR)
    (folder / GOLDEN_FILE).unlink()
    with pytest.raises(PolicyError, match=r"golden vectors of policy quick-2d .* are missing"):
        site.check(read_policy(folder), Mode.PLANAR)
    with pytest.raises(PolicyError, match=r"has no golden_vectors\.json"):
        signed(folder)


def test_signatures_of_before_golden_vectors_still_hold(folder):
    """Bytes as the version before signed them: without the fields that came later."""
    fields = ("policy_sha256", "card_sha256", "mode", "model_sha256", "approved_utc", "approved_by")
    approval = signed(folder)
    body = {name: getattr(approval, name) for name in fields} | {"key_id": approval.key_id}
    message = json.dumps(body, sort_keys=True, separators=(",", ":")).encode()
    signature = base64.b64encode(Ed25519PrivateKey.from_private_bytes(KEY).sign(message)).decode()
    old = Approval.model_validate_json(json.dumps(body | {"signature": signature}))
    (folder / GOLDEN_FILE).unlink()
    assert trust(old).check(read_policy(folder), Mode.PLANAR) == old


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
    rotated.check(read_policy(folder), Mode.PLANAR)
    # From then on the old key signs nothing, and the new one does.
    with pytest.raises(PolicyError, match="which was revoked"):
        sign_list(rotated, KEY).require_successor_of(rotated)
    sign_list(rotated, OTHER_KEY).require_successor_of(rotated)
    # A list that says nothing of the change is not followed.
    with pytest.raises(PolicyError, match="does not have"):
        sign_list(rotated, OTHER_KEY).require_successor_of(known)


LATER = "2026-03-02T00:00:00+00:00"


def rotated_twice(folder):
    """Lists of a site: before, after one change of the key, after two and the first key's revocation."""
    known = sign_list(trust(signed(folder)), KEY)
    once = rotate_key(known, KEY, OTHER_KEY, rotated_utc=LATER)
    twice = rotate_key(once, OTHER_KEY, THIRD_KEY, rotated_utc=LATER)
    return known, once, revoke_key(twice, public_key(KEY).key_id, THIRD_KEY)


def test_a_machine_that_was_away_follows_changes_of_the_key_by_itself(folder):
    known, once, last = rotated_twice(folder)
    for before in (None, known, once):
        last.require_successor_of(before)
    approval = last.check(read_policy(folder), Mode.PLANAR)
    assert (approval.key_id, approval.approved_by) == (public_key(THIRD_KEY).key_id, "eve")
    # Through JSON, as it travels.
    SiteTrust.model_validate_json(last.model_dump_json()).require_successor_of(known)


def test_what_a_revoked_key_signs_is_refused(folder):
    _, once, last = rotated_twice(folder)
    with pytest.raises(PolicyError, match="which was revoked"):
        sign_list(last, KEY).require_successor_of(last)
    # Also a further change of the key that it vouches for.
    evil = rotate_key(last, KEY, EVIL_KEY, rotated_utc=LATER)
    with pytest.raises(PolicyError, match="does not have"):
        evil.require_successor_of(last)
    approval = signed(folder)
    forged = sign_list(last.model_copy(update={"approvals": (approval,)}), THIRD_KEY)
    with pytest.raises(PolicyError, match="which was revoked"):
        forged.check(read_policy(folder), Mode.PLANAR)
    with pytest.raises(PolicyError, match="is the one that signs"):
        revoke_key(last, public_key(THIRD_KEY).key_id, THIRD_KEY)
    with pytest.raises(PolicyError, match="was revoked"):
        revoke_key(last, public_key(KEY).key_id, THIRD_KEY)
    with pytest.raises(PolicyError, match="is not newer"):
        once.require_successor_of(last)


@each(
    "change",
    [
        {"new_key": public_key(EVIL_KEY)},
        {"rotated_utc": "2030-01-01T00:00:00+00:00"},
        {"signature": ""},
        {"old_key_id": "0" * 16},
        {"site": "other"},
    ],
)
def test_no_word_of_a_change_of_the_key_can_be_changed(folder, change):
    known, once, _ = rotated_twice(folder)
    (rotation,) = once.rotations
    forged = once.model_copy(update={"rotations": (rotation.model_copy(update=change),)})
    signer = EVIL_KEY if "new_key" in change else OTHER_KEY
    with pytest.raises(PolicyError, match=r"is not that of key|is not signed|does not have"):
        sign_list(forged, signer).require_successor_of(known)


@each(
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
