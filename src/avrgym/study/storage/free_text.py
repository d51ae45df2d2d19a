"""Limits of free text in a study: length, and allowed characters."""

from avrgym.study.storage.state_transitions import StudyError

MAX_LINE_LENGTH, MAX_NOTE_LENGTH = 200, 10_000
"""Maximum number of characters of a line (name, contact or reason), and of a note."""


def check_single_line(what: str, text: str) -> None:
    """Raises ``StudyError`` if a name, contact or reason is too long or contains control characters.

    ``what``: name of the field in the message. The message does not contain the text.
    """
    _check(what, text, MAX_LINE_LENGTH, "")


def check_note(text: str, what: str = "the note") -> None:
    """Raises ``StudyError`` if a note is empty or too long, or contains control characters. Line breaks are allowed."""
    if not text:
        raise StudyError(f"{what} is empty; allowed: at least one character")
    _check(what, text, MAX_NOTE_LENGTH, "\n\r\t")


def _check(what: str, text: str, most: int, allowed: str) -> None:
    if len(text) > most:
        raise StudyError(f"{what} is {len(text)} characters long; allowed: at most {most}")
    if not all(character in allowed or _is_writable(character) for character in text):
        raise StudyError(f"{what} contains control characters; allowed: printable text")


def _is_writable(character: str) -> bool:
    """Returns whether a character is neither a control character nor a surrogate."""
    return not (character < " " or "\x7f" <= character < "\xa0" or "\ud800" <= character < "\ue000")
