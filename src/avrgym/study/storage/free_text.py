"""Limits of free text in a study: length, and characters that can be stored."""

from avrgym.study.storage.states import StudyError

MAX_LINE_LENGTH, MAX_NOTE_LENGTH = 200, 10_000
"""Maximum number of characters of a name, a contact or a reason, and of a note."""


def check_line(what: str, text: str) -> None:
    """Raise ``StudyError`` unless the text can be a name, a contact or a reason; the message does not repeat it."""
    _check(what, text, MAX_LINE_LENGTH, "")


def check_note(text: str, what: str = "the note") -> None:
    """Raise ``StudyError`` unless the text can be a note or a description; several lines are allowed."""
    if not text:
        raise StudyError(f"{what} is empty; allowed: at least one character")
    _check(what, text, MAX_NOTE_LENGTH, "\n\r\t")


def _check(what: str, text: str, most: int, allowed: str) -> None:
    if len(text) > most:
        raise StudyError(f"{what} is {len(text)} characters long; allowed: {most}")
    if not all(character in allowed or _is_writable(character) for character in text):
        raise StudyError(f"{what} contains control characters; allowed: printable text")


def _is_writable(character: str) -> bool:
    """Whether a character is neither a control character nor a surrogate, which databases or files cannot store."""
    return not (character < " " or "\x7f" <= character < "\xa0" or "\ud800" <= character < "\ue000")
