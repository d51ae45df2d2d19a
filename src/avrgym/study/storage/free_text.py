"""What people may write into a study: how long it may be, and that it is text."""

from avrgym.study.storage.states import StudyError

MAX_LINE_LENGTH, MAX_NOTE_LENGTH = 200, 10_000
"""Characters of a name, a contact or a reason, and of a note."""


def check_line(what: str, text: str) -> None:
    """``StudyError`` unless this can be a name, a contact or a reason; the words do not repeat it."""
    _check(what, text, MAX_LINE_LENGTH, "")


def check_note(text: str, what: str = "the note") -> None:
    """``StudyError`` unless this can be a note or a description, which may have several lines."""
    if not text:
        raise StudyError(f"{what} is empty; write something down")
    _check(what, text, MAX_NOTE_LENGTH, "\n\r\t")


def _check(what: str, text: str, most: int, allowed: str) -> None:
    if len(text) > most:
        raise StudyError(f"{what} is {len(text)} characters long; allowed: {most}")
    if not all(character in allowed or _is_writable(character) for character in text):
        raise StudyError(f"{what} holds control characters or what is no text; allowed: what can be written")


def _is_writable(character: str) -> bool:
    """Neither a control character, which not every database keeps, nor half of one, which no file does."""
    return not (character < " " or "\x7f" <= character < "\xa0" or "\ud800" <= character < "\ue000")
