"""Throw logs from machines, with the machine's own token in place of a person's session."""

import asyncio
import re
from typing import Annotated

from fastapi import APIRouter, Header, Request, Response

from server.dependencies import LogsDep, MachineCaller, ThrowsDep
from server.errors import ApiError

router = APIRouter(tags=["logs"])

MAX_BODY_BYTES = 512 * 1024 * 1024
"""Outer bound; the limit that counts is a setting (DOWNRANGE_LOG_MAX_BYTES)."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_THROW_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")


@router.put(
    "/machines/{machine_id}/throw-logs/{throw_id}",
    status_code=204,
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/octet-stream": {"schema": {"type": "string"}}},
        }
    },
)
async def put_throw_log(
    machine_id: MachineCaller,
    throw_id: str,
    request: Request,
    logs: LogsDep,
    throws: ThrowsDep,
    x_content_sha256: Annotated[str, Header()] = "",
) -> Response:
    """Store a throw's log; the same upload again changes nothing."""
    if not _SHA256.fullmatch(x_content_sha256) or not _THROW_ID.fullmatch(throw_id):
        raise ApiError("bad_upload", "A throw id and X-Content-SHA256 (64 hex digits) are needed.")
    await asyncio.to_thread(logs.require_throw, machine_id, throw_id)
    scratch, size_bytes = await logs.receive(request.stream(), x_content_sha256)
    is_new = await asyncio.to_thread(
        logs.keep, scratch, machine_id, throw_id, x_content_sha256, size_bytes
    )
    if is_new:
        await asyncio.to_thread(throws.publish, throw_id)
    return Response(status_code=204)
