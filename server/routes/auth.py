"""Accounts and sessions."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas import LoginRequest, SessionView

router = APIRouter(tags=["auth"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.post("/auth/login")
def login(body: LoginRequest) -> SessionView:
    """Sign in; sets the session cookie."""
    _later()


@router.post("/auth/logout", status_code=204)
def logout() -> None:
    """Sign out; gives leases back."""
    _later()


@router.get("/auth/me")
def read_me() -> SessionView:
    """Who is signed in."""
    _later()
