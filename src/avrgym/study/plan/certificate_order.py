"""The order of certificates in time stamps, which not every authority writes as DER requires.

The signature does not cover this order. The verifier reads DER alone.
"""

from collections.abc import Iterator

_PATH = (0, 1, 1, 0)
"""From a response to its signed data: content of the response, token, its content, signed data."""
_CERTIFICATES = 0xA0
"""The tag of the certificates in signed data."""


def sort_certificates(response: bytes) -> bytes:
    """A response of a time stamping authority with its certificates in the order of DER.

    Raises:
        IndexError: when the bytes are no such response.
    """
    start, end = 0, len(response)
    for place in _PATH:
        _, _, start, end = list(_elements(response, start, end))[place]
    for tag, _, first, last in _elements(response, start, end):
        if tag == _CERTIFICATES:
            certificates = sorted(response[at:after] for _, at, _, after in _elements(response, first, last))
            return response[:first] + b"".join(certificates) + response[last:]
    return response


def _elements(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """The elements between two places: tag, and the places of the element, its content and its end."""
    while start < end:
        length, content = data[start + 1], start + 2
        if length & 0x80:
            content += length & 0x7F
            length = int.from_bytes(data[start + 2 : content])
        yield data[start], start, content, content + length
        start = content + length
