"""A site approves policy versions by a signature; a machine that is bound to a site loads nothing else.

An approval binds the network, the card, the mode and the machine model. The signature is Ed25519 (RFC 8032)
over the approval as canonical JSON: keys sorted, no spaces, without the signature itself.
"""

import base64
import binascii
import json
from hashlib import sha256
from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import BaseModel, ConfigDict, Field

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, file_sha256, load_card

KEY_ID_COUNT = 16
"""Hex digits of the sha256 of a public key that name it."""


class Approval(BaseModel):
    """What a site has signed about one version."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    policy_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    card_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Of the card's bytes: a card that was altered after the approval is refused."""
    mode: Mode
    model_sha256: str
    approved_utc: str
    approved_by: str
    key_id: str
    signature: str = ""
    """Base64."""

    def signed_bytes(self) -> bytes:
        """What the signature is over."""
        body = self.model_dump(mode="json", exclude={"signature"})
        return json.dumps(body, sort_keys=True, separators=(",", ":")).encode()


class SiteKey(BaseModel):
    """A public key of a site."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    key_id: str
    public_key: str
    """Base64 of the 32 bytes."""
    is_revoked: bool = False


class SiteTrust(BaseModel):
    """What a machine trusts: the site's keys, and the approvals that they have signed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    site: str
    keys: tuple[SiteKey, ...]
    approvals: tuple[Approval, ...] = ()

    def check(self, folder: Path, mode: Mode) -> Approval:
        """The approval of the version in a folder.

        Raises:
            PolicyError: it is not approved for this mode, or the approval does not hold.
        """
        card = load_card(folder)
        name = f"policy {card.policy_id} ({card.policy_sha256[:12]})"
        found = [a for a in self.approvals if a.policy_sha256 == card.policy_sha256]
        if not found:
            raise PolicyError(f"{name} is not approved by site {self.site}")
        for approval in found:
            self._check_signature(approval, name)
            if approval.mode is not mode:
                raise PolicyError(
                    f"{name} is approved for mode {approval.mode.value}, not for {mode.value}"
                )
            if approval.model_sha256 != card.model_sha256:
                raise PolicyError(
                    f"{name} is approved for machine model {approval.model_sha256[:12]}, its card "
                    f"says {card.model_sha256[:12]}"
                )
        if file_sha256(folder / CARD_FILE) not in {a.card_sha256 for a in found}:
            raise PolicyError(f"the card of {name} was altered after its approval")
        return found[-1]

    def _check_signature(self, approval: Approval, name: str) -> None:
        key = next((key for key in self.keys if key.key_id == approval.key_id), None)
        if key is None:
            raise PolicyError(
                f"{name} is signed by key {approval.key_id[:16]}, which site {self.site} does not have"
            )
        if key.is_revoked:
            raise PolicyError(f"{name} is signed by key {key.key_id}, which was revoked")
        if not approval.signature:
            raise PolicyError(f"the approval of {name} is not signed")
        try:
            public = Ed25519PublicKey.from_public_bytes(base64.b64decode(key.public_key))
            public.verify(
                base64.b64decode(approval.signature, validate=True), approval.signed_bytes()
            )
        except (InvalidSignature, ValueError, binascii.Error) as error:
            raise PolicyError(
                f"the signature of the approval of {name} is not that of key {key.key_id}"
            ) from error


def new_private_key() -> bytes:
    """A fresh private key, 32 bytes."""
    return Ed25519PrivateKey.generate().private_bytes_raw()


def public_key(private_key: bytes) -> SiteKey:
    """The public part of a key."""
    raw = Ed25519PrivateKey.from_private_bytes(private_key).public_key().public_bytes_raw()
    key_id = sha256(raw).hexdigest()[:KEY_ID_COUNT]
    return SiteKey(key_id=key_id, public_key=base64.b64encode(raw).decode())


def approve(folder: Path, private_key: bytes, *, approved_by: str, approved_utc: str) -> Approval:
    """Sign the version in a folder.

    Raises:
        PolicyError: the folder holds no version whose file and card agree.
    """
    card = load_card(folder)
    approval = Approval(
        policy_sha256=card.policy_sha256,
        card_sha256=file_sha256(folder / CARD_FILE),
        mode=card.mode,
        model_sha256=card.model_sha256,
        approved_utc=approved_utc,
        approved_by=approved_by,
        key_id=public_key(private_key).key_id,
    )
    key = Ed25519PrivateKey.from_private_bytes(private_key)
    signature = base64.b64encode(key.sign(approval.signed_bytes())).decode()
    return approval.model_copy(update={"signature": signature})
