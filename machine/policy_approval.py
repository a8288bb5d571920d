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


def _canonical(body: object) -> bytes:
    return json.dumps(body, sort_keys=True, separators=(",", ":")).encode()


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
        return _canonical(self.model_dump(mode="json", exclude={"signature"}))


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
            PolicyError: there is none, or it is not this key's.
        """
        if not signature:
            raise PolicyError(f"{what} is not signed")
        try:
            public = Ed25519PublicKey.from_public_bytes(base64.b64decode(self.public_key))
            public.verify(base64.b64decode(signature, validate=True), message)
        except (InvalidSignature, ValueError, binascii.Error) as error:
            raise PolicyError(
                f"the signature of {what} is not that of key {self.key_id}"
            ) from error


class SiteTrust(BaseModel):
    """What a machine trusts: the site's keys, and the approvals that they have signed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    site: str
    keys: tuple[SiteKey, ...]
    approvals: tuple[Approval, ...] = ()
    serial_count: int = Field(default=0, ge=0)
    """Counts the lists of a site: a machine takes no older one, so that a withdrawn approval stays so."""
    signed_by: str = ""
    """Id of the key that signed the list."""
    signature: str = ""
    """Base64, over the whole list without itself."""

    def signed_bytes(self) -> bytes:
        """What the signature is over."""
        return _canonical(self.model_dump(mode="json", exclude={"signature"}))

    def require_successor_of(self, known: "SiteTrust | None") -> None:
        """Refuse a list that may not take the place of the one on board.

        Args:
            known: the list on board; None where the machine is bound to no site yet.

        Raises:
            PolicyError: it is of another site, older, or not signed by a key that `known` trusts.
        """
        issuer = self if known is None else known
        name = f"the list {self.serial_count} of site {self.site}"
        if issuer.site != self.site:
            raise PolicyError(f"{name}: this machine is bound to site {issuer.site}")
        issuer.key(self.signed_by, name).verify(self.signature, self.signed_bytes(), name)
        if known is not None and self.serial_count <= known.serial_count:
            raise PolicyError(f"{name} is not newer than list {known.serial_count} on board")

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
        if file_sha256(folder / CARD_FILE) not in {a.card_sha256 for a in found}:
            raise PolicyError(f"the card of {name} was altered after its approval")
        return found[-1]


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
    return approval.model_copy(update={"signature": _sign(private_key, approval.signed_bytes())})


def sign_list(trust: SiteTrust, private_key: bytes) -> SiteTrust:
    """The list as the next one of its site, signed."""
    numbered = trust.model_copy(
        update={
            "serial_count": trust.serial_count + 1,
            "signed_by": public_key(private_key).key_id,
            "signature": "",
        }
    )
    return numbered.model_copy(update={"signature": _sign(private_key, numbered.signed_bytes())})


def _sign(private_key: bytes, message: bytes) -> str:
    return base64.b64encode(
        Ed25519PrivateKey.from_private_bytes(private_key).sign(message)
    ).decode()
