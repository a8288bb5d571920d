"""Who may call: session cookie, exact origin, a header of ours on writes, and permissions."""

import asyncio

from fastapi import WebSocket
from starlette.requests import HTTPConnection

from server.accounts.accounts import COOKIE, Accounts, Session
from server.accounts.audit_chain import AuditChain, Entry
from server.errors import ForbiddenError, NotSignedInError
from server.schemas.console import Permission
from server.settings import Settings

WRITE_HEADER = "x-requested-with"
WRITE_HEADER_VALUE = "downrange"
_READS = frozenset({"GET", "HEAD", "OPTIONS"})


class AccessControl:
    """Checks requests and WebSockets."""

    def __init__(self, accounts: Accounts, audit: AuditChain, settings: Settings) -> None:
        self._accounts = accounts
        self._audit = audit
        self._settings = settings

    def check_origin(self, connection: HTTPConnection) -> None:
        """Refuse what did not come from a page of this server.

        Raises:
            ForbiddenError: no or another Origin.
        """
        origin = connection.headers.get("origin")
        allowed = self._settings.allowed_origins
        if origin not in allowed:
            raise ForbiddenError(
                "wrong_origin",
                f"Origin {origin or 'missing'} is not allowed; this server answers "
                f"{', '.join(sorted(allowed))}. Set DOWNRANGE_ORIGINS to the address in the browser.",
            )

    def check_write(self, connection: HTTPConnection) -> None:
        """Refuse writes that another site's page could have caused.

        Raises:
            ForbiddenError: wrong origin, or the header of writes is missing.
        """
        if connection.scope.get("method", "GET") in _READS:
            return
        self.check_origin(connection)
        if not connection.headers.get(WRITE_HEADER):
            raise ForbiddenError(
                "missing_header",
                f"Writes need the header X-Requested-With: {WRITE_HEADER_VALUE}.",
            )

    def session_of(self, connection: HTTPConnection) -> Session:
        """The caller's session.

        Raises:
            ForbiddenError: a write from another page.
            NotSignedInError: no session, or it has ended.
        """
        self.check_write(connection)
        session = self._accounts.session_of(connection.cookies.get(COOKIE))
        if session is None:
            raise NotSignedInError("not_signed_in", "No session, or it has ended. Sign in.")
        return session

    def require(
        self, connection: HTTPConnection, session: Session, permission: Permission
    ) -> Session:
        """The session, if it holds a permission. A refusal is recorded in the audit.

        Raises:
            ForbiddenError: the role lacks the permission.
        """
        if session.may(permission):
            return session
        self._audit.record(
            Entry(
                session.actor,
                permission.value,
                "denied",
                machine_id=connection.path_params.get("machine_id"),
                detail={"path": connection.url.path, "role": session.role},
            )
        )
        raise ForbiddenError(
            "not_allowed",
            f"Role {session.role} may not do this; it needs the right '{permission}'.",
            {"permission": permission},
        )

    async def socket_session(self, websocket: WebSocket, permission: Permission) -> Session | None:
        """The caller's session for a WebSocket.

        Returns None for another origin, no session or a session without the permission.
        """

        def find() -> Session | None:
            try:
                self.check_origin(websocket)
            except ForbiddenError:
                return None
            session = self._accounts.session_of(websocket.cookies.get(COOKIE))
            return session if session is not None and session.may(permission) else None

        return await asyncio.to_thread(find)
