"""A site approves policy versions by a signature; a machine that is bound to a site loads nothing else.

An approval binds the network, the card, the golden vectors, the mode and the machine model. The signature is
Ed25519 (RFC 8032) over the approval as canonical JSON: keys sorted, no spaces, without the signature itself.
"""

import base64
import binascii
import json
from hashlib import sha256

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import BaseModel, ConfigDict, Field

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import GOLDEN_FILE, PolicyFiles

KEY_ID_COUNT = 16
"""Hex digits of the sha256 of a public key that name it."""


def _signed_part(model: BaseModel) -> bytes:
    """Canonical JSON without the signature and without what is not set."""
    # Fields that came later are None in older documents: their signatures go on to hold.
    body = model.model_dump(mode="json", exclude={"signature"}, exclude_none=True)
    return json.dumps(body, sort_keys=True, separators=(",", ":")).encode()


class Approval(BaseModel):
    """What a site has signed about one version."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    policy_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    card_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Of the card's bytes: a card that was altered after the approval is refused."""
    golden_sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    """Of golden_vectors.json; None in approvals of before there were any, whose signature lacks it too."""
    mode: Mode
    model_sha256: str
    approved_utc: str
    approved_by: str
    key_id: str
    signature: str = ""
    """Base64."""

    def signed_bytes(self) -> bytes:
        """What the signature is over."""
        return _signed_part(self)


class SiteKey(BaseModel):
    """A public key of a site."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    key_id: str
    public_key: str
    """Base64 of the 32 bytes."""
    is_revoked: bool = False

    def verify(self, signature: str, message: bytes, what: str) -> None:
        """Check a signature (base64) of this key.

        Raises:
            PolicyError: there is none, it is not this key's, or the key is not the one that its id names.
        """
        if not signature:
            raise PolicyError(f"{what} is not signed")
        try:
            raw = base64.b64decode(self.public_key)
            if _key_id(raw) != self.key_id:
                raise PolicyError(
                    f"{what} names key {self.key_id[:KEY_ID_COUNT]} and holds another"
                )
            public = Ed25519PublicKey.from_public_bytes(raw)
            public.verify(base64.b64decode(signature, validate=True), message)
        except (InvalidSignature, ValueError, binascii.Error) as error:
            raise PolicyError(
                f"the signature of {what} is not that of key {self.key_id}"
            ) from error


class KeyRotation(BaseModel):
    """A site has a new key: signed by the one before, so that a machine that was away follows by itself."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    site: str
    old_key_id: str
    new_key: SiteKey
    rotated_utc: str
    signature: str = ""
    """Base64, of the old key."""

    def signed_bytes(self) -> bytes:
        """What the signature is over."""
        return _signed_part(self)


class SiteTrust(BaseModel):
    """What a machine trusts: the site's keys, and the approvals that they have signed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    site: str
    keys: tuple[SiteKey, ...]
    approvals: tuple[Approval, ...] = ()
    rotations: tuple[KeyRotation, ...] | None = None
    """Every change of the key, oldest first; None where there was none."""
    serial_count: int = Field(default=0, ge=0)
    """Counts the lists of a site: a machine takes no older one, so that a withdrawn approval stays so."""
    signed_by: str = ""
    """Id of the key that signed the list."""
    signature: str = ""
    """Base64, over the whole list without itself."""

    def signed_bytes(self) -> bytes:
        """What the signature is over."""
        return _signed_part(self)

    def require_successor_of(self, known: "SiteTrust | None") -> None:
        """Refuse a list that may not take the place of the one on board.

        Args:
            known: the list on board; None where the machine is bound to no site yet.

        Raises:
            PolicyError: it is of another site, older, or not signed by a key that `known` trusts, or that
                such a key has passed its trust on to.
        """
        issuer = self if known is None else self._followed(known)
        name = f"the list {self.serial_count} of site {self.site}"
        if issuer.site != self.site:
            raise PolicyError(f"{name}: this machine is bound to site {issuer.site}")
        issuer.key(self.signed_by, name).verify(self.signature, self.signed_bytes(), name)
        if known is not None and self.serial_count <= known.serial_count:
            raise PolicyError(f"{name} is not newer than list {known.serial_count} on board")

    def bound_by(self, key_id: str) -> "SiteTrust":
        """What a machine trusts before its first list, where a person has named the site's key.

        Raises:
            PolicyError: the site does not have this key, or it was revoked.
        """
        key = self.key(key_id, f"the list {self.serial_count} that this machine may take first")
        return SiteTrust(site=self.site, keys=(key,))

    def _followed(self, known: "SiteTrust") -> "SiteTrust":
        """`known` with the keys that its own keys have passed their trust on to, one after the other."""
        keys = {key.key_id: key for key in known.keys}
        for rotation in self.rotations or ():
            old, new = keys.get(rotation.old_key_id), rotation.new_key
            if old is None or old.is_revoked or new.key_id in keys or rotation.site != known.site:
                continue
            what = f"the change of site {known.site} to key {new.key_id}"
            old.verify(rotation.signature, rotation.signed_bytes(), what)
            keys[new.key_id] = new
        return known.model_copy(update={"keys": tuple(keys.values())})

    def key(self, key_id: str, what: str) -> SiteKey:
        """A key that may sign.

        Raises:
            PolicyError: the site does not have it, or it was revoked.
        """
        found = next((key for key in self.keys if key.key_id == key_id), None)
        if found is None:
            raise PolicyError(
                f"{what} is signed by key {key_id[:16]}, which site {self.site} does not have"
            )
        if found.is_revoked:
            raise PolicyError(f"{what} is signed by key {found.key_id}, which was revoked")
        return found

    def check(self, files: PolicyFiles, mode: Mode) -> Approval:
        """The approval of a version.

        Args:
            files: as they were read; the same are to be loaded.
            mode: it is to be used in.

        Raises:
            PolicyError: it is not approved for this mode, or the approval does not hold.
        """
        card = files.card
        name = f"policy {card.policy_id} ({card.policy_sha256[:12]})"
        found = [a for a in self.approvals if a.policy_sha256 == card.policy_sha256]
        if not found:
            raise PolicyError(f"{name} is not approved by site {self.site}")
        for approval in found:
            key = self.key(approval.key_id, name)
            key.verify(approval.signature, approval.signed_bytes(), f"the approval of {name}")
            if approval.mode is not mode:
                raise PolicyError(
                    f"{name} is approved for mode {approval.mode.value}, not for {mode.value}"
                )
            if approval.model_sha256 != card.model_sha256:
                raise PolicyError(
                    f"{name} is approved for machine model {approval.model_sha256[:12]}, its card "
                    f"says {card.model_sha256[:12]}"
                )
        same_card = [a for a in found if a.card_sha256 == files.card_sha256]
        if not same_card:
            raise PolicyError(f"the card of {name} was altered after its approval")
        for approval in same_card:
            if approval.golden_sha256 in (None, files.golden_sha256):
                return approval
        what = "are missing" if files.golden is None else "were altered after its approval"
        raise PolicyError(f"the golden vectors of {name} {what}; copy the policy again")


def new_private_key() -> bytes:
    """A fresh private key, 32 bytes."""
    return Ed25519PrivateKey.generate().private_bytes_raw()


def public_key(private_key: bytes) -> SiteKey:
    """The public part of a key."""
    raw = Ed25519PrivateKey.from_private_bytes(private_key).public_key().public_bytes_raw()
    return SiteKey(key_id=_key_id(raw), public_key=base64.b64encode(raw).decode())


def _key_id(public_bytes: bytes) -> str:
    return sha256(public_bytes).hexdigest()[:KEY_ID_COUNT]


def approve(
    files: PolicyFiles, private_key: bytes, *, approved_by: str, approved_utc: str
) -> Approval:
    """Sign a version.

    Raises:
        PolicyError: it has no golden vectors.
    """
    card = files.card
    if files.golden_sha256 is None:
        raise PolicyError(f"{card.policy_id} has no {GOLDEN_FILE}")
    approval = Approval(
        policy_sha256=card.policy_sha256,
        card_sha256=files.card_sha256,
        golden_sha256=files.golden_sha256,
        mode=card.mode,
        model_sha256=card.model_sha256,
        approved_utc=approved_utc,
        approved_by=approved_by,
        key_id=public_key(private_key).key_id,
    )
    return approval.model_copy(update={"signature": sign(private_key, approval.signed_bytes())})


def sign_list(trust: SiteTrust, private_key: bytes) -> SiteTrust:
    """The list as the next one of its site, signed."""
    numbered = trust.model_copy(
        update={
            "serial_count": trust.serial_count + 1,
            "signed_by": public_key(private_key).key_id,
            "signature": "",
        }
    )
    return numbered.model_copy(update={"signature": sign(private_key, numbered.signed_bytes())})


def rotate_key(trust: SiteTrust, old_key: bytes, new_key: bytes, *, rotated_utc: str) -> SiteTrust:
    """The site's next list, signed by a new key that the old one vouches for; all approvals are signed anew.

    Args:
        trust: the list in use.
        old_key: private key that signed it; it goes on to be trusted until it is revoked.
        new_key: private key that signs from now on.
        rotated_utc: when, ISO 8601.
    """
    added = public_key(new_key)
    rotation = KeyRotation(
        site=trust.site,
        old_key_id=public_key(old_key).key_id,
        new_key=added,
        rotated_utc=rotated_utc,
    )
    signature = sign(old_key, rotation.signed_bytes())
    approvals: list[Approval] = []
    for one in trust.approvals:
        again = one.model_copy(update={"key_id": added.key_id})
        approvals.append(
            again.model_copy(update={"signature": sign(new_key, again.signed_bytes())})
        )
    changed = trust.model_copy(
        update={
            "keys": (*trust.keys, added),
            "approvals": tuple(approvals),
            "rotations": (
                *(trust.rotations or ()),
                rotation.model_copy(update={"signature": signature}),
            ),
        }
    )
    return sign_list(changed, new_key)


def revoke_key(trust: SiteTrust, key_id: str, private_key: bytes) -> SiteTrust:
    """The site's next list, in which a key is revoked: what it has signed counts no more.

    Raises:
        PolicyError: the site does not have the key, it is revoked already, or it is the one that signs.
    """
    found = trust.key(key_id, f"key {key_id}: what it signs")
    if found == public_key(private_key):
        raise PolicyError(f"key {key_id} is the one that signs; rotate it first")
    keys = tuple(
        key.model_copy(update={"is_revoked": True}) if key == found else key for key in trust.keys
    )
    return sign_list(trust.model_copy(update={"keys": keys}), private_key)


def sign(private_key: bytes, message: bytes) -> str:
    """Signature of a message, base64."""
    return base64.b64encode(
        Ed25519PrivateKey.from_private_bytes(private_key).sign(message)
    ).decode()
