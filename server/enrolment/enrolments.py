"""One-time tokens: a person adds a machine here, its computer fetches its credentials once.

Only the hash of a token is stored. A machine's password leaves the server with the first use of a valid
token and never again by it.
"""

import hashlib
import secrets
from datetime import timedelta
from typing import Final
from urllib.parse import urlsplit

from pydantic import JsonValue, TypeAdapter
from sqlalchemy import Select, select

from server.accounts.audit_chain import Actor, AuditChain, Entry
from server.clock import new_id, utc_now
from server.deployments.site_approvals import SiteApprovals
from server.errors import ConflictError, NotSignedInError
from server.machines.machine_registry import MachineRegistry
from server.schemas.enrolment import (
    CredentialsView,
    EnrolmentStage,
    EnrolmentView,
    SelfTestItem,
    SelfTestReport,
)
from server.settings import Settings
from server.store.database import Database
from server.store.enrolment_models import Enrolment

TOKEN_S: Final = 3600.0
"""A walk to the machine and its setup; a token that lies about is void soon."""
_VOID: Final = (
    "This token is unknown, used, replaced or expired. Make a new one on the machine's page."
)
_ITEMS: Final = TypeAdapter(tuple[SelfTestItem, ...])
_WILDCARDS: Final = frozenset({"0.0.0.0", "[::]", ""})


class Enrolments:
    """Issues tokens and takes them in."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        approvals: SiteApprovals,
        settings: Settings,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._approvals = approvals
        self._settings = settings

    def add(self, machine_id: str | None, name: str, actor: Actor) -> tuple[str, str, Enrolment]:
        """List a machine and issue its token; returns id, token and what is stored of it.

        Raises:
            ConflictError: the id is of a retired machine, or of one that is connected.
        """
        machine_id = self._registry.enrol(machine_id, name, actor)
        token, row = self.issue(machine_id, actor)
        return machine_id, token, row

    def issue(self, machine_id: str, actor: Actor) -> tuple[str, Enrolment]:
        """A new token of a machine; earlier ones are void.

        Raises:
            NotFoundError: there is none of this id.
            ConflictError: it is connected or retired.
        """
        known = self._registry.get(machine_id)
        if known.retired_utc is not None:
            raise ConflictError("retired", f"{machine_id} is retired. Add a new machine.")
        if known.is_connected:
            raise ConflictError(
                "machine_connected", f"{machine_id} is connected: it has its credentials already."
            )
        # Hexadecimal: a command line takes a word that begins with a dash for an option.
        token, now = secrets.token_hex(24), utc_now()
        row = Enrolment(
            enrolment_id=new_id(),
            machine_id=machine_id,
            token_sha256=_digest(token),
            created_by=actor.name[:64],
            created_utc=now,
            expires_utc=now + timedelta(seconds=TOKEN_S),
            claimed_utc=None,
            claimed_from="",
            self_test=None,
            tested_utc=None,
        )
        with self._database.write() as session:
            session.add(row)
            entry = Entry(actor, "machine.token", "fact", machine_id=machine_id)
            self._audit.append(session, entry)
        return token, row

    def view(self, machine_id: str) -> EnrolmentView | None:
        """The newest enrolment of a machine; None where it was never added by a token.

        Raises:
            NotFoundError: there is none of this id.
        """
        self._registry.get(machine_id)
        with self._database.read() as session:
            row = session.scalars(_newest(machine_id)).first()
        if row is None:
            return None
        return EnrolmentView(
            machine_id=machine_id,
            stage=_stage(row),
            created_by=row.created_by,
            created_utc=row.created_utc,
            expires_utc=row.expires_utc,
            claimed_utc=row.claimed_utc,
            claimed_from=row.claimed_from,
            self_test=_ITEMS.validate_python(row.self_test or []),
            tested_utc=row.tested_utc,
        )

    def claim(self, token: str, address: str, host: str) -> CredentialsView:
        """Hand the credentials over to whoever has the token.

        Args:
            token: as it was shown.
            address: of the caller.
            host: name by which the caller reached this server; machines call in there as well.

        Raises:
            NotSignedInError: no such token, or it was used, replaced or has expired.
        """
        query = select(Enrolment).where(Enrolment.token_sha256 == _digest(token))
        with self._database.read() as session:
            # Guesses never wait for, or hold up, those who write.
            is_known = session.scalars(query).first() is not None
        if not is_known:
            raise NotSignedInError("wrong_token", _VOID)
        with self._database.write() as session:
            row = session.scalars(query.with_for_update()).first()
            newest = None if row is None else session.scalars(_newest(row.machine_id)).first()
            known = None if row is None else self._registry.get(row.machine_id)
            is_void = (
                row is None
                or newest is not row
                or _stage(row) is not EnrolmentStage.WAITING
                or known is None
                or known.retired_utc is not None
            )
            if row is None or is_void:
                raise NotSignedInError("wrong_token", _VOID)
            row.claimed_utc, row.claimed_from = utc_now(), address[:64]
            detail: dict[str, JsonValue] = {"address": address[:64], "token_by": row.created_by}
            entry = Entry(
                Actor(row.machine_id),
                "machine.claim",
                "fact",
                machine_id=row.machine_id,
                detail=detail,
            )
            self._audit.append(session, entry)
            machine_id = row.machine_id
        authority = self._settings.link_root_ca
        return CredentialsView(
            machine_id=machine_id,
            site=self._settings.site,
            password=self._registry.password(machine_id),
            connect=(self.link_address(host),),
            root_ca_pem=None if authority is None else authority.read_text(encoding="ascii"),
            server_utc=utc_now(),
            trust=self._approvals.trust(),
        )

    def take_self_test(self, machine_id: str, report: SelfTestReport) -> None:
        """Store what a machine found of itself.

        Raises:
            ConflictError: it was never added by a token.
        """
        with self._database.write() as session:
            row = session.scalars(_newest(machine_id)).first()
            if row is None or row.claimed_utc is None:
                raise ConflictError(
                    "not_enrolled",
                    f"{machine_id} was not added by a token; there is no test to report.",
                )
            row.self_test = [item.model_dump(mode="json") for item in report.items]
            row.tested_utc = utc_now()
            failed: list[JsonValue] = [item.name for item in report.items if not item.is_passed]
            entry = Entry(
                Actor(machine_id),
                "machine.self_test",
                "fact",
                machine_id=machine_id,
                detail={"failed": failed},
            )
            self._audit.append(session, entry)

    def site_key_id(self) -> str:
        """Id of the key that signs the site's policies."""
        return self._approvals.trust().signed_by

    def link_address(self, host: str) -> str:
        """Endpoint at which machines call in, as they see it.

        Args:
            host: name by which the asker reached this server; stands for a router that listens everywhere.
        """
        if self._settings.link_address is not None:
            return self._settings.link_address
        scheme, _, rest = self._settings.link_listen.partition("/")
        name, _, port = rest.rpartition(":")
        if name not in _WILDCARDS:
            return self._settings.link_listen
        reached = urlsplit(f"//{host}").hostname or "localhost"
        return f"{scheme}/{f'[{reached}]' if ':' in reached else reached}:{port}"


def _newest(machine_id: str) -> Select[Enrolment]:
    return (
        select(Enrolment)
        .where(Enrolment.machine_id == machine_id)
        .order_by(Enrolment.enrolment_id.desc())
        .limit(1)
    )


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _stage(row: Enrolment) -> EnrolmentStage:
    if row.tested_utc is not None:
        return EnrolmentStage.TESTED
    if row.claimed_utc is not None:
        return EnrolmentStage.CLAIMED
    return EnrolmentStage.EXPIRED if row.expires_utc <= utc_now() else EnrolmentStage.WAITING
