"""Who may call: session cookie, exact origin and own header on writes, rights; for HTTP and WebSockets."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Annotated

from fastapi import Depends, WebSocket
from starlette.requests import HTTPConnection

from server.accounts.audit import Entry
from server.accounts.auth import COOKIE, Session
from server.errors import ForbiddenError, NotSignedInError
from server.schemas.console import Permission
from server.services import Services, ServicesDep

OWN_HEADER = "x-requested-with"
OWN_VALUE = "downrange"
_READS = frozenset({"GET", "HEAD", "OPTIONS"})


def check_origin(headers: Mapping[str, str], services: Services) -> None:
    """Refuse what did not come from our own pages.

    Raises:
        ForbiddenError: no or another Origin.
    """
    origin = headers.get("origin")
    allowed = services.settings.allowed_origins
    if origin not in allowed:
        raise ForbiddenError(
            "wrong_origin",
            f"Origin {origin or 'missing'} is not allowed; this server answers "
            f"{', '.join(sorted(allowed))}. Set DOWNRANGE_ORIGINS to the address in the browser.",
        )


def check_write(connection: HTTPConnection, services: Services) -> None:
    """Refuse writes that another site's page could have caused.

    Raises:
        ForbiddenError: wrong origin, or our own header is missing.
    """
    if connection.scope.get("method", "GET") in _READS:
        return
    check_origin(connection.headers, services)
    if not connection.headers.get(OWN_HEADER):
        raise ForbiddenError(
            "missing_header", f"Writes need the header X-Requested-With: {OWN_VALUE}."
        )


def check_own_page(connection: HTTPConnection, services: ServicesDep) -> None:
    """`check_write` as a dependency: before the body is looked at."""
    check_write(connection, services)


def current_session(connection: HTTPConnection, services: ServicesDep) -> Session:
    """The caller's session.

    Raises:
        NotSignedInError: none, or it has ended.
    """
    check_write(connection, services)
    session = services.accounts.session_of(connection.cookies.get(COOKIE))
    if session is None:
        raise NotSignedInError("not_signed_in", "No session, or it has ended. Sign in.")
    return session


SessionDep = Annotated[Session, Depends(current_session)]


def requires(
    permission: Permission,
) -> Callable[[HTTPConnection, ServicesDep, SessionDep], Session]:
    """A dependency that lets only holders of a right pass, and records who was refused."""

    def check(connection: HTTPConnection, services: ServicesDep, session: SessionDep) -> Session:
        if session.may(permission):
            return session
        services.audit.record(
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

    return check


async def socket_session(
    websocket: WebSocket, services: Services, permission: Permission
) -> Session | None:
    """The caller's session for a WebSocket; None for another origin, no session or without the right."""

    def find() -> Session | None:
        try:
            check_origin(websocket.headers, services)
        except ForbiddenError:
            return None
        session = services.accounts.session_of(websocket.cookies.get(COOKIE))
        return session if session is not None and session.may(permission) else None

    return await asyncio.to_thread(find)


Viewer = Annotated[Session, Depends(requires(Permission.VIEW))]
Lessee = Annotated[Session, Depends(requires(Permission.LEASE))]
Thrower = Annotated[Session, Depends(requires(Permission.THROW))]
ImpactMarker = Annotated[Session, Depends(requires(Permission.IMPACT_MARK))]
LeaseTaker = Annotated[Session, Depends(requires(Permission.LEASE_TAKE))]
StopClearer = Annotated[Session, Depends(requires(Permission.STOP_CLEAR))]
GapRunner = Annotated[Session, Depends(requires(Permission.GAP_RUN))]
TwinKeeper = Annotated[Session, Depends(requires(Permission.TWIN_APPLY))]
SiteEditor = Annotated[Session, Depends(requires(Permission.SITE_EDIT))]
Auditor = Annotated[Session, Depends(requires(Permission.AUDIT_READ))]
Enroller = Annotated[Session, Depends(requires(Permission.MACHINE_ENROL))]
