"""User administration from the server's computer. Every change is written to the audit.

At least one admin stays enabled. A new password ends the user's sessions; a new role applies at once.
"""

import re
from typing import NamedTuple

from argon2 import PasswordHasher
from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from machine.errors import UsageError
from server.accounts.audit_chain import SERVER, AuditChain, Entry
from server.clock import utc_now
from server.schemas.console import Role
from server.store.database import Database
from server.store.models import LoginSession, User

NAME_PATTERN = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
MIN_PASSWORD_COUNT = 12
"""Characters."""


class UserInfo(NamedTuple):
    """An account without its password."""

    username: str
    role: Role
    is_disabled: bool


class UserAdmin:
    """Lists and changes user accounts."""

    def __init__(self, database: Database, audit: AuditChain) -> None:
        self._database = database
        self._audit = audit
        self._hasher = PasswordHasher()

    def listed(self) -> list[UserInfo]:
        """All accounts, by name."""
        with self._database.read() as session:
            users = session.scalars(select(User).order_by(User.username))
            return [UserInfo(user.username, Role(user.role), user.is_disabled) for user in users]

    def add(self, username: str, password: str, role: Role) -> None:
        """Make an account.

        Raises:
            UsageError: an invalid or taken name, or a short password.
        """
        if not NAME_PATTERN.fullmatch(username):
            raise UsageError(
                f"{username!r} is no name: small letters, digits, '.', '_' and '-', at most 64"
            )
        hashed = self._hash(password)
        with self._database.write() as session:
            if session.get(User, username) is not None:
                raise UsageError(f"there is a {username} already; choose another name")
            user = User(
                username=username,
                password_hash=hashed,
                role=role.value,
                is_disabled=False,
                created_utc=utc_now(),
            )
            session.add(user)
            self._note(session, "user.create", username, role=role.value)

    def set_password(self, username: str, password: str) -> None:
        """Set a new password and end the user's sessions.

        Raises:
            UsageError: unknown user, or a short password.
        """
        hashed = self._hash(password)
        with self._database.write() as session:
            self._find(session, username).password_hash = hashed
            self._end_sessions(session, username)
            self._note(session, "user.password", username)

    def set_role(self, username: str, role: Role) -> None:
        """Set the role of a user.

        Raises:
            UsageError: unknown user, or the last admin.
        """
        with self._database.write() as session:
            user = self._find(session, username)
            if role is not Role.ADMIN:
                self._keep_an_admin(session, user)
            before, user.role = user.role, role.value
            self._note(session, "user.role", username, before=before, role=role.value)

    def set_disabled(self, username: str, *, is_disabled: bool) -> None:
        """Disable a user and end the user's sessions, or enable the user again.

        Raises:
            UsageError: unknown user, or the last admin.
        """
        with self._database.write() as session:
            user = self._find(session, username)
            if is_disabled:
                self._keep_an_admin(session, user)
                self._end_sessions(session, username)
            user.is_disabled = is_disabled
            self._note(session, "user.disable" if is_disabled else "user.enable", username)

    def _hash(self, password: str) -> str:
        if len(password) < MIN_PASSWORD_COUNT:
            raise UsageError(
                f"the password has {len(password)} characters; {MIN_PASSWORD_COUNT} are needed"
            )
        return self._hasher.hash(password)

    def _find(self, session: Session, username: str) -> User:
        user = session.get(User, username)
        if user is None:
            raise UsageError(f"there is no {username}; `downrange user list` shows who there is")
        return user

    def _keep_an_admin(self, session: Session, user: User) -> None:
        others = select(func.count()).where(
            User.role == Role.ADMIN.value,
            User.is_disabled.is_(False),
            User.username != user.username,
        )
        if user.role == Role.ADMIN.value and not session.scalar(others):
            raise UsageError(f"{user.username} is the last admin; make another one first")

    def _end_sessions(self, session: Session, username: str) -> None:
        session.execute(
            update(LoginSession)
            .where(LoginSession.username == username, LoginSession.ended_utc.is_(None))
            .values(ended_utc=utc_now())
        )

    def _note(self, session: Session, action: str, username: str, **detail: str) -> None:
        entry = Entry(SERVER, action, "fact", detail={"username": username, **detail})
        self._audit.append(session, entry)
