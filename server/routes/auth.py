"""Sign in and out."""

from fastapi import APIRouter, Depends, Request, Response

from server.accounts.accounts import COOKIE
from server.accounts.known_devices import DEVICE_COOKIE
from server.dependencies import (
    AccessDep,
    AccountsDep,
    DevicesDep,
    SessionDep,
    SettingsDep,
    check_write,
)
from server.errors import NotSignedInError
from server.schemas.console import LoginRequest, SessionView

router = APIRouter(tags=["auth"])

DEVICE_COOKIE_S = 365 * 24 * 3600


@router.post("/auth/login", dependencies=[Depends(check_write)])
def login(
    body: LoginRequest,
    request: Request,
    response: Response,
    accounts: AccountsDep,
    settings: SettingsDep,
    devices: DevicesDep,
) -> SessionView:
    """Sign in; sets the session cookie."""
    address = request.client.host if request.client else "unknown"
    device_id = devices.device_of(request.cookies.get(DEVICE_COOKIE), body.username)
    token, session = accounts.login(body.username, body.password, address, device_id)
    response.set_cookie(
        DEVICE_COOKIE,
        devices.issue(body.username, device_id),
        max_age=DEVICE_COOKIE_S,
        httponly=True,
        samesite="strict",
        secure=settings.secure_cookie,
        path="/",
    )
    response.set_cookie(
        COOKIE,
        token,
        max_age=int(settings.session_s),
        httponly=True,
        samesite="strict",
        secure=settings.secure_cookie,
        path="/",
    )
    return session.view()


@router.post("/auth/logout", status_code=204)
def logout(response: Response, session: SessionDep, accounts: AccountsDep) -> None:
    """Sign out; leases are given back and streams end."""
    accounts.logout(session)
    response.delete_cookie(COOKIE, path="/")


@router.get("/auth/me")
def read_me(request: Request, access: AccessDep) -> SessionView | None:
    """Who is signed in; null without a session, which is no error: every first visit asks."""
    try:
        return access.session_of(request).view()
    except NotSignedInError:
        return None
