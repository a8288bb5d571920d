"""Local accounts, server-side sessions, and roles.

A session's token lives only in the browser's HttpOnly cookie; the database holds its hash. Listeners
of a session's end release what it held: lease, streams, targets.
"""

import hashlib
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from sqlalchemy import func, select

from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.clock import new_id, utc_now
from server.errors import NotSignedInError
from server.limits.logins import LoginRateLimit
from server.schemas.console import Permission, Role, SessionView
from server.secret_files import write_secret
from server.store.database import Database
from server.store.models import LoginSession, User

COOKIE = "downrange_session"
FIRST_USERS = (("operator", Role.OPERATOR), ("admin", Role.ADMIN))
FIRST_LOGIN_FILE = "demo-login.txt"

_VIEWER = frozenset({Permission.VIEW, Permission.STOP})
_OPERATOR = _VIEWER | {
    Permission.LEASE,
    Permission.THROW,
    Permission.IMPACT_MARK,
    Permission.GAP_RUN,
    Permission.SITE_EDIT,
    Permission.ALERT_ACKNOWLEDGE,
}
_SUPERVISOR = _OPERATOR | {
    Permission.LEASE_TAKE,
    Permission.STOP_CLEAR,
    Permission.AUDIT_READ,
    Permission.MACHINE_EDIT,
    Permission.ZONES_APPROVE,
}
_ENGINEER = _SUPERVISOR | {
    Permission.TWIN_APPLY,
    Permission.AIM_APPLY,
    Permission.POLICY_UPLOAD,
    Permission.POLICY_VALIDATE,
    Permission.POLICY_APPROVE,
    Permission.POLICY_DEPLOY,
}
PERMISSIONS = MappingProxyType(
    {
        Role.VIEWER: _VIEWER,
        Role.OPERATOR: _OPERATOR,
        Role.SUPERVISOR: _SUPERVISOR,
        Role.ENGINEER: _ENGINEER,
        Role.ADMIN: frozenset(Permission),
    }
)
"""What each role may do."""


@dataclass(frozen=True, slots=True)
class Session:
    """A signed-in person."""

    session_id: str
    username: str
    role: Role
    expires_utc: datetime

    @property
    def actor(self) -> Actor:
        """For the audit."""
        return Actor(self.username, self.session_id)

    def may(self, permission: Permission) -> bool:
        """Whether the role holds a right."""
        return permission in PERMISSIONS[self.role]

    def view(self) -> SessionView:
        """For the console."""
        return SessionView(
            session_id=self.session_id,
            username=self.username,
            role=self.role,
            permissions=tuple(sorted(PERMISSIONS[self.role])),
            expires_utc=self.expires_utc,
        )


class Accounts:
    """Users and their sessions."""

    def __init__(self, database: Database, audit: AuditChain, session_s: float) -> None:
        self._database = database
        self._audit = audit
        self._session_s = session_s
        self._hasher = PasswordHasher()
        self._login_limit = LoginRateLimit()
        self._ended: list[Callable[[Session], None]] = []

    def on_session_end(self, listener: Callable[[Session], None]) -> None:
        """Call this when a session ends by logout."""
        self._ended.append(listener)

    def create_user(self, username: str, password: str, role: Role) -> None:
        """Add an account."""
        with self._database.write() as session:
            session.add(
                User(
                    username=username,
                    password_hash=self._hasher.hash(password),
                    role=role.value,
                    is_disabled=False,
                    created_utc=utc_now(),
                )
            )
            self._audit.append(
                session,
                Entry(SERVER, "user.create", "fact", detail={"username": username, "role": role}),
            )

    def create_first_users(self, folder: Path) -> None:
        """Make `operator` and `admin` with fresh passwords if there is no account at all."""
        with self._database.read() as session:
            if session.scalar(select(User.username).limit(1)) is not None:
                return
        passwords = {name: secrets.token_urlsafe(12) for name, _ in FIRST_USERS}
        write_secret(
            folder / FIRST_LOGIN_FILE,
            "".join(f"{name} {password}\n" for name, password in passwords.items()),
        )
        for name, role in FIRST_USERS:
            self.create_user(name, passwords[name], role)

    def count_with(self, permission: Permission) -> int:
        """Accounts in use whose role holds a right."""
        roles = [role.value for role, held in PERMISSIONS.items() if permission in held]
        query = select(func.count()).where(User.role.in_(roles), User.is_disabled.is_(False))
        with self._database.read() as session:
            return session.scalar(query) or 0

    def login(
        self, username: str, password: str, address: str, device_id: str | None = None
    ) -> tuple[str, Session]:
        """Check a password and open a session; returns its token.

        Args:
            username: account.
            password: as typed.
            address: of the caller.
            device_id: of a browser in which this person has signed in before.

        Raises:
            TooManyRequestsError: too many failures.
            NotSignedInError: unknown name or wrong password; the answer is the same for both.
        """
        self._login_limit.attempt(username, address, device_id)
        with self._database.read() as session:
            user = session.get(User, username)
        if not self._matches(user, password) or user is None or user.is_disabled:
            self._audit.record(
                Entry(Actor(username), "login", "denied", detail={"address": address})
            )
            raise NotSignedInError("login_failed", "Name or password is wrong.")
        self._login_limit.succeed(username, address, device_id)
        token = secrets.token_urlsafe(32)
        now = utc_now()
        opened = Session(
            new_id(), username, Role(user.role), now + timedelta(seconds=self._session_s)
        )
        with self._database.write() as session:
            session.add(
                LoginSession(
                    session_id=opened.session_id,
                    token_sha256=_digest(token),
                    username=username,
                    created_utc=now,
                    expires_utc=opened.expires_utc,
                    ended_utc=None,
                )
            )
            self._audit.append(
                session, Entry(opened.actor, "login", "fact", detail={"address": address})
            )
        return token, opened

    def session_of(self, token: str | None) -> Session | None:
        """The session of a cookie, None when there is none that is valid now."""
        if not token or len(token) > 128:
            return None
        with self._database.read() as session:
            found = session.execute(
                select(LoginSession, User.role)
                .join(User, User.username == LoginSession.username)
                .where(
                    LoginSession.token_sha256 == _digest(token),
                    LoginSession.ended_utc.is_(None),
                    LoginSession.expires_utc > utc_now(),
                    User.is_disabled.is_(False),
                )
            ).first()
        if found is None:
            return None
        row, role = found
        return Session(row.session_id, row.username, Role(role), row.expires_utc)

    def logout(self, ended: Session) -> None:
        """End a session and tell the listeners."""
        with self._database.write() as session:
            row = session.get(LoginSession, ended.session_id)
            if row is not None:
                row.ended_utc = utc_now()
            self._audit.append(session, Entry(ended.actor, "logout", "fact"))
        for listener in self._ended:
            listener(ended)

    @cached_property
    def _decoy_hash(self) -> str:
        return self._hasher.hash(secrets.token_urlsafe(16))

    def _matches(self, user: User | None, password: str) -> bool:
        # An unknown name costs the same time as a known one.
        stored = self._decoy_hash if user is None else user.password_hash
        try:
            return self._hasher.verify(stored, password)
        except (VerificationError, InvalidHashError):
            return False


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
