"""Sign in and out."""

from fastapi import APIRouter, Depends, Request, Response

from server.accounts.access import SessionDep, check_own_page
from server.accounts.auth import COOKIE
from server.schemas.console import LoginRequest, SessionView
from server.services import ServicesDep

router = APIRouter(tags=["auth"])


@router.post("/auth/login", dependencies=[Depends(check_own_page)])
def login(
    body: LoginRequest, request: Request, response: Response, services: ServicesDep
) -> SessionView:
    """Sign in; sets the session cookie."""
    address = request.client.host if request.client else "unknown"
    token, session = services.accounts.login(body.username, body.password, address)
    response.set_cookie(
        COOKIE,
        token,
        max_age=int(services.settings.session_s),
        httponly=True,
        samesite="strict",
        secure=services.settings.secure_cookie,
        path="/",
    )
    return session.view()


@router.post("/auth/logout", status_code=204)
def logout(response: Response, session: SessionDep, services: ServicesDep) -> None:
    """Sign out; leases are given back and streams end."""
    services.accounts.logout(session)
    response.delete_cookie(COOKIE, path="/")


@router.get("/auth/me")
def read_me(session: SessionDep) -> SessionView:
    """Who is signed in."""
    return session.view()
