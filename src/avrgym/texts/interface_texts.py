"""Interface texts for participants: one file for each language, with the same keys.

AVR Gym includes the languages of the ``.toml`` files in this package. A study can add languages, and translations of
its own sentences, in the file ``texts/LANGUAGE.toml`` in its folder.
"""

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import Any

import msgspec

from avrgym.system.files import read_user_text

TEXTS_FOLDER = "texts"
"""Folder of a study's own texts, relative to the study's folder."""
LANGUAGE_TAG_PATTERN = re.compile(r"[a-z]{2,3}(-[A-Za-z0-9]{2,8})*")
"""Pattern of a BCP 47 language tag, as in HTML's ``lang``."""
TEXT_DIRECTIONS = ("ltr", "rtl")
"""Text directions, as in HTML's ``dir``."""
MAX_LISTED_TEXT_KEYS = 5
"""Maximum number of missing keys in an error message."""
_NUMBER = re.compile(r"^(\d+)\.(\d+)$")
OPTIONAL_PAGE_TEXT_KEYS = (
    "link_ended",
    "enter_code",
    "code",
    "open_session",
    "wrong_code",
    "too_many_codes",
    "robot_commands",
    "stop_by_switch",
    "stop_by_experimenter",
    "by_dwell",
    "by_scan",
    "by_step",
    "by_remote",
    "caption_success",
    "prefer",
)
HOSTED_STUDY_KEY_PREFIX = "host_"
"""Prefix of the keys under ``page`` for the pages of hosted studies. They are optional too."""
OPTIONAL_SESSION_TEXT_KEYS = ("headset_stretched_one", "reach_ahead_one", "reach_aside_one", "no_preferences")
"""Optional keys under ``session``. As for ``OPTIONAL_PAGE_TEXT_KEYS``, the default is the English text."""
PAGE_TEXT_KEY_SUFFIX = "_page"
"""Suffix of keys under ``session`` for the participant's page without a headset."""
SELECT_PLACEHOLDER, SELECT_ACTION_KEY_PREFIX = "select", "select_by_"
"""Placeholder for the name of the select action, and prefix of the keys with the names for each select input."""
CHOOSE_PLACEHOLDER, CHOOSE_ACTION_KEY_PREFIX = "choose", "choose_by_"
"""Placeholder and prefix of keys for the action that chooses a named button."""
INPUT_PROFILE_SELECT_INPUTS = ("dwell", "scan", "step", "remote")
"""Select inputs of input profiles: head, one switch, two switches, experimenter. Their names are optional."""
DEFAULT_SELECT_INPUT = "trigger"
"""Select input of texts without another input."""


class InvalidTextsError(ValueError):
    """Raised if the texts of a language are missing or invalid. The message contains file and allowed values."""


@dataclass(frozen=True)
class ParticipantText:
    """A text for a participant. ``text_key``: key under ``session``. ``placeholder_values``: values of placeholders, by
    name.
    """

    text_key: str
    placeholder_values: "Mapping[str, str | ParticipantText]" = field(
        default_factory=dict[str, "str | ParticipantText"]
    )


class TextsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contents of a text file, see ``InterfaceTexts``. In a study's file, all parts are optional."""

    name: str = ""
    direction: str = ""
    decimal: str = ""
    session: dict[str, str] = {}
    page: dict[str, str] = {}
    sentences: dict[str, str] = {}


@dataclass(frozen=True)
class InterfaceTexts:
    """All texts in one language.

    ``language``: a tag such as ``de``. ``name``: name of the language. ``direction``: ``ltr`` or ``rtl``. ``decimal``:
    decimal separator. ``session``: texts of the server, by key. ``page``: texts of the client, by key. ``sentences``:
    translations of sentences of tasks, questionnaires and designs, by English sentence.
    """

    language: str
    name: str
    direction: str
    decimal: str
    session: Mapping[str, str]
    page: Mapping[str, str]
    sentences: Mapping[str, str]

    def format_for_vr(self, text: ParticipantText, select_by: str = DEFAULT_SELECT_INPUT) -> str:
        """Returns the text for VR with filled-in placeholders. ``select_by``: select input, such as ``trigger``."""
        select, choose = (
            self.session.get(prefix + select_by, "")
            for prefix in (SELECT_ACTION_KEY_PREFIX, CHOOSE_ACTION_KEY_PREFIX)
        )
        values = {
            name: self._render_value(value, select_by) for name, value in text.placeholder_values.items()
        }
        values |= {
            SELECT_PLACEHOLDER: select,
            SELECT_PLACEHOLDER.capitalize(): select[:1].upper() + select[1:],
            CHOOSE_PLACEHOLDER: choose,
        }
        return self.session[text.text_key].format_map(values)

    def _render_value(self, value: str | ParticipantText, select_by: str) -> str:
        if isinstance(value, ParticipantText):
            return self.format_for_vr(value, select_by)
        return _NUMBER.sub(rf"\1{self.decimal}\2", value)

    def format_by_select_input(self, text: ParticipantText) -> dict[str, str]:
        """Returns the texts for VR, by select input. Texts that equal the text for the default input are omitted."""
        kinds = [
            key.removeprefix(SELECT_ACTION_KEY_PREFIX)
            for key in self.session
            if key.startswith(SELECT_ACTION_KEY_PREFIX)
        ]
        texts = {kind: self.format_for_vr(text, kind) for kind in kinds}
        return {kind: rendered for kind, rendered in texts.items() if rendered != self.format_for_vr(text)}

    def format_for_page(self, text: ParticipantText) -> str:
        """Returns the text for the page without a headset, with values instead of placeholders."""
        on_page = text.text_key + PAGE_TEXT_KEY_SUFFIX
        return self.format_for_vr(
            ParticipantText(on_page, text.placeholder_values) if on_page in self.session else text
        )

    def translate(self, sentence: str) -> str:
        """Returns the translation of an English sentence, or the sentence itself without a translation."""
        return self.sentences.get(normalize_whitespace(sentence), sentence)

    def find_untranslated_sentences(self, sentences: Collection[str]) -> list[str]:
        """Returns the English sentences that have no translation, without duplicates."""
        unique_sentences = dict.fromkeys(
            normalize_whitespace(sentence) for sentence in sentences if sentence.strip()
        )
        return [sentence for sentence in unique_sentences if sentence not in self.sentences]


class ParticipantActionError(ValueError):
    """Raised if the participant cannot do an action. ``text``: the reason, for the participant."""

    def __init__(self, text: ParticipantText) -> None:
        super().__init__(ENGLISH_TEXTS.format_for_vr(text))
        self.participant_text = text


def normalize_whitespace(sentence: str) -> str:
    """Returns the sentence with single spaces instead of line breaks and spaces, as the key of its translation."""
    return " ".join(sentence.split())


def list_included_languages() -> list[str]:
    """Returns the tags of the languages that AVR Gym includes."""
    included = (
        file.name.removesuffix(".toml") for file in files("avrgym.texts").iterdir() if _is_toml(file.name)
    )
    return sorted(included)


def read_texts(language: str, folder: Path | None = None) -> InterfaceTexts:
    """Returns the texts in a language. Texts in the study's ``folder`` replace those of AVR Gym.

    Raises:
        InvalidTextsError: for an unknown language, or a missing or unknown text. Also for placeholders that differ from
            the English text.
    """
    if not LANGUAGE_TAG_PATTERN.fullmatch(language):
        raise InvalidTextsError(f"{language!r} is not a language tag; allowed: a tag such as en, de or pt-BR")
    own = folder / TEXTS_FOLDER / f"{language}.toml" if folder is not None else None
    included = _read_included(language) if language in list_included_languages() else TextsFile()
    added = _read_own(own) if own is not None and own.is_file() else TextsFile()
    where = str(own) if own is not None else f"{TEXTS_FOLDER}/{language}.toml in a study's folder"
    if included == added == TextsFile():
        raise InvalidTextsError(
            f"no texts in {language!r}: AVR Gym includes {', '.join(list_included_languages())}; add others in {where}"
        )
    texts = InterfaceTexts(
        language,
        added.name or included.name or language,
        added.direction or included.direction or TEXT_DIRECTIONS[0],
        added.decimal or included.decimal or ".",
        {key: _ENGLISH.session[key] for key in OPTIONAL_SESSION_TEXT_KEYS} | included.session | added.session,
        {key: text for key, text in _ENGLISH.page.items() if is_optional_page_text_key(key)}
        | included.page
        | added.page,
        {
            normalize_whitespace(sentence): text
            for sentence, text in (included.sentences | added.sentences).items()
        },
    )
    _check(texts, where)
    return texts


def is_optional_page_text_key(key: str) -> bool:
    """Returns whether a language may omit a key under ``page``. The English text then replaces it."""
    return key in OPTIONAL_PAGE_TEXT_KEYS or key.startswith(HOSTED_STUDY_KEY_PREFIX)


@cache
def _read_included(language: str) -> TextsFile:
    file = files("avrgym.texts") / f"{language}.toml"
    return _read(file.read_text("utf-8"), f"{language}.toml")


def _read_own(path: Path) -> TextsFile:
    try:
        return _read(read_user_text(path), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTextsError(f"{path} cannot be read: {error}; allowed: a text file in UTF-8") from None


def _read(text: str, name: str) -> TextsFile:
    try:
        values: Any = tomllib.loads(text)
        return msgspec.convert(values, TextsFile)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise InvalidTextsError(f"{name}: {error}") from None


def _check(texts: InterfaceTexts, where: str) -> None:
    """Raises ``InvalidTextsError`` if keys or placeholders differ from the English texts.

    A language may have additional page texts (``PAGE_TEXT_KEY_SUFFIX``). It needs names of select actions only if a
    text contains ``{select}`` or ``{choose}``.
    """
    if texts.direction not in TEXT_DIRECTIONS:
        raise InvalidTextsError(
            f"{where}: direction {texts.direction!r}; allowed: {', '.join(TEXT_DIRECTIONS)}"
        )
    for table in ("session", "page"):
        expected: Mapping[str, str] = getattr(_ENGLISH, table)
        found: Mapping[str, str] = getattr(texts, table)
        own = [text for key, text in found.items() if key not in OPTIONAL_SESSION_TEXT_KEYS]
        named = {name for text in own for name in _names(text)}
        needed = [key for key in expected if _is_needed(key, named)]
        missing = [key for key in needed if not found.get(key, "").strip()]
        like = {key: key if key in expected else key.removesuffix(PAGE_TEXT_KEY_SUFFIX) for key in found}
        unknown = [key for key, english in like.items() if english not in expected]
        if missing:
            more = (
                f" and {len(missing) - MAX_LISTED_TEXT_KEYS} more"
                if len(missing) > MAX_LISTED_TEXT_KEYS
                else ""
            )
            untranslated = f"{', '.join(missing[:MAX_LISTED_TEXT_KEYS])}{more}"
            raise InvalidTextsError(
                f"{where} lacks {untranslated} in [{table}]; allowed: a text for each key of the English file"
            )
        if unknown:
            raise InvalidTextsError(
                f"{where}: unknown {unknown[0]} in [{table}]; allowed: {', '.join(expected)}"
            )
        for key, text in found.items():
            names = _names(expected[like[key]]) - _SELECTS
            if _names(text) - _SELECTS != names:
                allowed = ", ".join(f"{{{name}}}" for name in sorted(names)) or "none"
                raise InvalidTextsError(
                    f"{where}: {key} in [{table}] has other placeholders than English; allowed: {allowed}"
                )


_SELECTS = {SELECT_PLACEHOLDER, SELECT_PLACEHOLDER.capitalize(), CHOOSE_PLACEHOLDER}


def _is_needed(key: str, named: Collection[str]) -> bool:
    """Returns whether a language needs a key. ``named``: the placeholders in its texts."""
    for prefix, placeholders in (
        (SELECT_ACTION_KEY_PREFIX, {SELECT_PLACEHOLDER, SELECT_PLACEHOLDER.capitalize()}),
        (CHOOSE_ACTION_KEY_PREFIX, {CHOOSE_PLACEHOLDER}),
    ):
        if key.startswith(prefix):
            return key.removeprefix(prefix) not in INPUT_PROFILE_SELECT_INPUTS and bool(
                placeholders & set(named)
            )
    return True


@cache
def _names(text: str) -> frozenset[str]:
    """Returns the placeholders of a text, including conversions and format specifications, which are not allowed."""
    try:
        return frozenset(
            name + (f"!{how}" if how else "") + (f":{form}" if form else "")
            for _, name, form, how in Formatter().parse(text)
            if name is not None
        )
    except ValueError:
        return frozenset("{")


def _is_toml(name: str) -> bool:
    return name.endswith(".toml")


_ENGLISH = _read_included("en")
ENGLISH_TEXTS = read_texts("en")
"""The English texts of AVR Gym."""
