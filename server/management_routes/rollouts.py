"""Rollouts of policy versions."""

from typing import Literal

from fastapi import APIRouter

from machine.conventions import Mode
from server.dependencies import Deployer, RolloutsDep, Viewer
from server.rollouts.rollout_views import (
    ChannelsView,
    RolloutChangeRequest,
    RolloutRequest,
    RolloutView,
)

router = APIRouter(tags=["policies"])


@router.get("/policy-rollouts")
def list_rollouts(session: Viewer, rollouts: RolloutsDep) -> list[RolloutView]:
    """The newest twenty, newest first, with their machines."""
    return rollouts.newest()


@router.get("/policy-rollouts/{rollout_id}")
def read_rollout(rollout_id: str, session: Viewer, rollouts: RolloutsDep) -> RolloutView:
    """One rollout: stages, machines, throws before and since, and what happened."""
    return rollouts.view(rollout_id)


@router.get("/policy-channels")
def list_channels(session: Viewer, rollouts: RolloutsDep) -> list[ChannelsView]:
    """Candidate and stable version of each mode."""
    return rollouts.channels()


@router.post("/policy-rollouts/{mode}/start", status_code=201)
def start_rollout(
    mode: Mode, body: RolloutRequest, session: Deployer, rollouts: RolloutsDep
) -> RolloutView:
    """Bring a version to machines in stages; each ends by a test on real throws."""
    return rollouts.start(mode, body, session)


@router.post("/policy-rollouts/{rollout_id}/change/{change}")
def change_rollout(
    rollout_id: str,
    change: Literal["pause", "resume", "promote", "abort"],
    body: RolloutChangeRequest,
    session: Deployer,
    rollouts: RolloutsDep,
) -> RolloutView:
    """Pause; resume; promote, which ends the stage; or abort, which takes every machine back."""
    changes = {
        "pause": rollouts.pause,
        "resume": rollouts.resume,
        "promote": rollouts.promote,
        "abort": rollouts.abort,
    }
    return changes[change](rollout_id, body.reason, session)
