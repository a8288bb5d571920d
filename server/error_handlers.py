"""Every error of the HTTP interface in one shape: {"error": {code, message, detail}}."""

import logging
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import JsonValue
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response

from machine.conventions import FILLED_LINE_PATTERN, LINE_PATTERN
from machine.errors import DownrangeError
from server.errors import ApiError, TooManyRequestsError

logger = logging.getLogger(__name__)

_HTTP_CODES = {
    404: ("not_found", "There is nothing at this address."),
    405: ("wrong_method", "This address does not take this method."),
    413: ("too_large", "The body is too large."),
}
_PATTERN_WORDS = {
    FILLED_LINE_PATTERN: "it has to be one line with something to read",
    LINE_PATTERN: "it has to be one line",
}


def error_response(
    status_code: int, code: str, message: str, detail: JsonValue = None
) -> JSONResponse:
    """An error in the one shape."""
    body = {"error": {"code": code, "message": message, "detail": detail}}
    return JSONResponse(body, status_code=status_code, headers={"Cache-Control": "no-store"})


def api_error_response(error: ApiError) -> JSONResponse:
    """An error of ours in the one shape, also for a WebSocket that is not accepted."""
    response = error_response(error.status_code, error.code, error.message, error.detail)
    if isinstance(error, TooManyRequestsError) and isinstance(error.detail, dict):
        wait_s = error.detail.get("retry_after_s")
        if isinstance(wait_s, float):
            response.headers["Retry-After"] = str(int(wait_s) + 1)
    return response


async def _api_error(_request: Request, error: Exception) -> Response:
    assert isinstance(error, ApiError)
    return api_error_response(error)


async def _own_error(_request: Request, error: Exception) -> Response:
    assert isinstance(error, DownrangeError)
    return error_response(400, error.code, str(error))


async def _invalid(_request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    # What was sent is not sent back: it may hold NaN, megabytes or a password.
    problems: list[dict[str, JsonValue]] = [
        {
            "field": ".".join(str(part) for part in item["loc"]),
            "problem": _problem(item),
        }
        for item in error.errors()
    ]
    first = problems[0] if problems else {"field": "request", "problem": "not valid"}
    return error_response(
        422,
        "invalid",
        f"{str(first['field']).removeprefix('body.')}: {first['problem']}.",
        {"problems": list[JsonValue](problems[:20])},
    )


def _problem(item: dict[str, Any]) -> str:
    """What is wrong with a field, in words also where a pattern says it."""
    pattern = item.get("ctx", {}).get("pattern")
    return _PATTERN_WORDS.get(pattern, str(item["msg"]).removeprefix("Value error, "))


async def _http(_request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code, message = _HTTP_CODES.get(error.status_code, ("http_error", str(error.detail)))
    response = error_response(error.status_code, code, message)
    for name, value in (error.headers or {}).items():
        response.headers[name] = value
    return response


async def _database(request: Request, error: Exception) -> Response:
    logger.error("database error at %s", request.url.path, exc_info=error)
    return error_response(
        503, "database", "The database does not answer as it should. Check it and try again."
    )


async def _unexpected(request: Request, error: Exception) -> Response:
    logger.error("unexpected error at %s", request.url.path, exc_info=error)
    return error_response(
        500, "internal", "The server made a mistake. The operator's log of the server says where."
    )


def add_error_handlers(app: FastAPI) -> None:
    """Give an application the one error shape."""
    app.add_exception_handler(ApiError, _api_error)
    app.add_exception_handler(DownrangeError, _own_error)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(SQLAlchemyError, _database)
    app.add_exception_handler(Exception, _unexpected)
