"""JSON bodies of requests, of limited size, and JSON responses."""

from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
from fastapi import HTTPException, Request, Response

B = TypeVar("B", bound=msgspec.Struct)


class EmptyRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A request body without fields: ``{}``."""


async def read_json_body(request: Request, max_bytes: int) -> bytearray:
    """Returns the undecoded body of a request.

    Raises:
        HTTPException: 415 for a content type other than JSON, 413 for more than ``max_bytes``.
    """
    if request.headers.get("content-type") != "application/json":
        raise HTTPException(415, "the content type must be application/json")
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > max_bytes:
            raise HTTPException(413, f"the request is too long; at most {max_bytes} bytes are allowed")
    return data


async def decode_json_body(request: Request, kind: type[B], max_bytes: int) -> B:
    """Returns the decoded body of a request. Error messages contain no values, because values may be names of people.

    Raises:
        HTTPException: as ``read_json_body``; 422 for a body that is not a ``kind``.
    """
    data = await read_json_body(request, max_bytes)
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise HTTPException(422, str(error)) from None
    except RecursionError:
        raise HTTPException(
            422, "the JSON is nested too deeply; allowed: the fields of the request"
        ) from None


def make_json_response(value: Any, status: int = 200) -> Response:
    """Returns a response that contains a value as JSON."""
    return Response(msgspec.json.encode(value), status, media_type="application/json")


def make_error_handler(status: int, **more: str) -> Callable[[Request, Exception], Response]:
    """Returns an exception handler. It responds with this status, the error's message and the fields ``more``."""
    return lambda _request, error: make_json_response({"detail": str(error), **more}, status)
