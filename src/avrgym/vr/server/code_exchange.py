"""Endpoint at which the page on a headset exchanges a code for the link of the current session."""

from collections.abc import Awaitable, Callable

import msgspec
from fastapi import HTTPException, Request, Response

from avrgym.vr.server.request_body import make_json_response, read_json_body
from avrgym.vr.server.session_links import CodeError, SessionLinks, TooManyWrongCodesError

MAX_REQUEST_BODY_BYTES = 1000


class HeadsetCodeRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The digits of the code that was entered on a headset."""

    code: str


def make_code_endpoint(links: SessionLinks) -> Callable[[Request], Awaitable[Response]]:
    """Returns the endpoint, which responds to a valid code with the token of the link."""

    async def exchange(request: Request) -> Response:
        entered = await _read(request)
        try:
            token = links.exchange_code("".join(entered.code.split()))
        except TooManyWrongCodesError as error:
            raise HTTPException(429, str(error)) from None
        except CodeError as error:
            raise HTTPException(403, str(error)) from None
        return make_json_response({"token": token})

    return exchange


async def _read(request: Request) -> HeadsetCodeRequest:
    data = await read_json_body(request, MAX_REQUEST_BODY_BYTES)
    try:
        return msgspec.json.decode(data, type=HeadsetCodeRequest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise HTTPException(422, 'send the code as {"code": "123456"}') from None
