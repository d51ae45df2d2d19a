"""JSON bodies of requests, of limited size."""

from fastapi import HTTPException, Request


async def read_json_body(request: Request, max_bytes: int) -> bytearray:
    """Returns the undecoded body of a request.

    Raises:
        HTTPException: 415 for a content type other than JSON, 413 for more than ``max_bytes``.
    """
    if request.headers.get("content-type") != "application/json":
        raise HTTPException(415, "send application/json")
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > max_bytes:
            raise HTTPException(413, f"the request is too long; at most {max_bytes} bytes are allowed")
    return data
