"""Policies."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas_history import PolicyView

router = APIRouter(tags=["policies"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get("/policies")
def list_policies() -> list[PolicyView]:
    """All policy versions."""
    _later()


@router.get("/policies/{policy_sha256}")
def read_policy(policy_sha256: str) -> PolicyView:
    """One policy version."""
    _later()
