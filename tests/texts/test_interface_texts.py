"""Laws of the texts for participants: every language is complete, and a study's texts override the included ones."""

import re
import stat
from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.models.human import SKIN_TONES
from avrgym.texts.interface_texts import (
    CHOOSE_ACTION_KEY_PREFIX,
    ENGLISH_TEXTS,
    INPUT_PROFILE_SELECT_INPUTS,
    PAGE_TEXT_KEY_SUFFIX,
    SELECT_ACTION_KEY_PREFIX,
    TEXTS_FOLDER,
    InvalidTextsError,
    ParticipantText,
    list_included_languages,
    normalize_whitespace,
    read_texts,
)
from avrgym.vr.protocol.messages import Language, ParticipantReady, PhaseDescription, Problem, Stop
from avrgym.vr.server.authentication import Tokens
from helpers.vr.visit import Visit, plan

GERMAN = read_texts("de")
ALIKE = {"anchor", "one_after_another", "seconds"}
"""What has no words."""
IN_VR_ALONE = ("wrong_height", "reach_")
"""Prefixes of the keys of texts that only participants with a headset receive."""
INPUTS = {"trigger", "button", "touchpad", "pinch", "tap", "gaze", *INPUT_PROFILE_SELECT_INPUTS}
NAMES = (SELECT_ACTION_KEY_PREFIX, CHOOSE_ACTION_KEY_PREFIX)
SELECTS = re.compile(r"trigger|pinch|Abzug|Zeigefinger", re.IGNORECASE)
CONTROLLER = re.compile(r"\{select\}|trigger|menu|\bA, B|Abzug|Menü", re.IGNORECASE)


def whole_file(direction: str = "rtl") -> str:
    """All texts in a language of our own: the English ones from behind, but for what stands in braces."""
    tables = {"session": ENGLISH_TEXTS.session, "page": ENGLISH_TEXTS.page}
    lines = [f'name = "Hsilgne"\ndirection = "{direction}"']
    for table, texts in tables.items():
        turned = {key: "".join(reversed(re.findall(r"\{\w+\}|.", text))) for key, text in texts.items()}
        lines += [f"[{table}]", *(f"{key} = '''{text}'''" for key, text in turned.items())]
    return "\n".join(lines)


def own(folder: Path, language: str, text: str) -> Path:
    (folder / TEXTS_FOLDER).mkdir(exist_ok=True)
    (folder / TEXTS_FOLDER / f"{language}.toml").write_text(text, "utf-8")
    return folder


@pytest.mark.parametrize("language", list_included_languages())
def test_every_language_is_complete(language: str) -> None:
    texts = read_texts(language)
    assert set(SKIN_TONES) <= set(texts.page)
    for table in ("session", "page"):
        english, found = getattr(ENGLISH_TEXTS, table), getattr(texts, table)
        assert list(found) == list(english)
        alike = {key for key in english if found[key] == english[key]}
        assert language == "en" or alike <= ALIKE
    for key, text in texts.session.items():
        if CONTROLLER.search(text) and not key.endswith(PAGE_TEXT_KEY_SUFFIX) and not key.startswith(NAMES):
            on_page = texts.session.get(
                key + PAGE_TEXT_KEY_SUFFIX, "" if key.startswith(IN_VR_ALONE) else text
            )
            assert not CONTROLLER.search(on_page), key


@pytest.mark.parametrize("language", list_included_languages())
def test_texts_mention_only_the_participants_input(language: str) -> None:
    """Each kind of input has its own words, in VR and in what is put into other words."""
    texts = read_texts(language)
    kinds = [
        key.removeprefix(SELECT_ACTION_KEY_PREFIX)
        for key in texts.session
        if key.startswith(SELECT_ACTION_KEY_PREFIX)
    ]
    assert set(kinds) == INPUTS
    values = {name: "x" for name in ("trial", "goal", "seconds", "faults", "moved_cm", "most_cm")}
    for key, text in texts.session.items():
        if "{select}" not in text.lower() or key.endswith(PAGE_TEXT_KEY_SUFFIX):
            assert key.startswith(NAMES) or not SELECTS.search(text), key
            continue
        said = ParticipantText("more_faults", {"faults": ParticipantText(key, values), "more": "1"})
        by_input = texts.format_by_select_input(said)
        assert set(by_input) == INPUTS - {"trigger"}
        assert len({texts.format_for_vr(said), *by_input.values()}) == len(INPUTS)
        for kind, told in by_input.items():
            words = texts.session[SELECT_ACTION_KEY_PREFIX + kind]
            assert words[1:] in told
            assert texts.session[f"{SELECT_ACTION_KEY_PREFIX}trigger"][1:] not in told


def test_a_language_of_an_earlier_version_has_one_way_to_select(tmp_path: Path) -> None:
    lines = whole_file().replace("{select}", "reggirt").replace("{Select}", "reggirT").splitlines()
    old = "\n".join(line for line in lines if not line.startswith(NAMES)).replace("{choose}", "esoohc")
    texts = read_texts("xx", own(tmp_path, "xx", old))
    assert "reggirT" in texts.format_for_vr(ParticipantText("ready", {"trial": "1", "goal": ""}))
    assert texts.format_by_select_input(ParticipantText("ready", {"trial": "1", "goal": ""})) == {}
    with pytest.raises(InvalidTextsError, match="lacks select_by_trigger"):
        read_texts("yy", own(tmp_path, "yy", old.replace("reggirt", "{select}")))


def test_the_participant_hears_of_their_input_wherever_they_are_spoken_to(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan())
    visit.go_to("calibration")
    assert "Then pinch" in visit.received(PhaseDescription)[-1].texts_by_input["pinch"]
    visit.session.send_initial_state(visit.inbox.append, "participant", 0.0)
    assert "Then pinch" in visit.received(PhaseDescription)[-1].texts_by_input["pinch"]
    visit.tracking = False
    visit.tick(100)
    visit.send(ParticipantReady())
    assert "then pinch" in visit.received(Problem)[-1].messages_by_input["pinch"]
    visit.leave()


def test_a_study_brings_a_language_written_from_right_to_left(tmp_path: Path) -> None:
    texts = read_texts("ar-EG", own(tmp_path, "ar-EG", whole_file()))
    assert (texts.direction, texts.name) == ("rtl", "Hsilgne")
    assert texts.format_for_vr(ParticipantText("trial", {"trial": "2", "trials": "8"})) == "8 fo 2 lairT"
    visit = Visit(tmp_path, replace(plan(), texts=texts))
    visit.session.send_initial_state(visit.inbox.append, "participant", 0.0)
    told = visit.received(Language)[-1]
    assert (told.language, told.direction, told.texts["stop"]) == ("ar-EG", "rtl", "tobor eht potS")
    visit.leave()


def test_a_study_changes_single_texts_of_a_language(tmp_path: Path) -> None:
    folder = own(tmp_path, "de", '[page]\nenter = "Los"\n[sentences]\n"a\\n b" = "c"')
    texts = read_texts("de", folder)
    assert (texts.page["enter"], texts.page["leave"]) == ("Los", GERMAN.page["leave"])
    assert texts.translate(" a b ") == "c"
    assert texts.find_untranslated_sentences(["a b", "d", "d", " "]) == ["d"]
    assert normalize_whitespace("a\n  b ") == "a b"


@pytest.mark.parametrize(
    ("language", "text", "words"),
    [
        ("xx", None, "AVR Gym includes de, en"),
        ("../de", None, "allowed: a tag such as"),
        ("xx", "[session]\npractice = 'x'", "lacks trial, waiting, "),
        ("de", "[page]\nenterr = 'x'", "unknown enterr"),
        ("de", "[page]\nenter = ''", "lacks enter"),
        ("de", "[session]\ntrial = 'x {trial}'", "allowed: {trial}, {trials}"),
        ("de", "[session]\ntrial = '{trial.__class__} {trials}'", "other placeholders"),
        ("de", "[session]\ntrial = '{trial!r} {trials}'", "other placeholders"),
        ("de", "[session]\npractice = '{'", "allowed: none"),
        ("de", "direction = 'down'", "allowed: ltr, rtl"),
        ("de", "[page]\nenter = 1", "Expected `str`"),
        ("de", "nonsense", "de.toml: "),
    ],
)
def test_texts_that_cannot_be_are_refused_in_one_line(
    tmp_path: Path, language: str, text: str | None, words: str
) -> None:
    folder = tmp_path if text is None else own(tmp_path, language, text)
    with pytest.raises(InvalidTextsError, match=re.escape(words)) as refused:
        read_texts(language, folder)
    assert "\n" not in str(refused.value)


def test_a_session_uses_one_language(tmp_path: Path) -> None:
    """Phases, problems and numbers are in German; the experimenter reads English."""
    visit = Visit(tmp_path, replace(plan(), texts=GERMAN))
    visit.go_to("trial")
    visit.send(ParticipantReady(), Stop())
    said = [(phase.text, phase.page_text) for phase in visit.received(PhaseDescription)]
    german = {text.split("{")[0] for text in GERMAN.session.values() if text.split("{")[0]}
    for texts in said:
        assert all(any(text.startswith(begin) for begin in german) for text in texts)
    assert said[-1] == (GERMAN.format_for_vr(ParticipantText("stopped")), GERMAN.session["stopped_page"])
    problem = visit.received(Problem)[-1]
    assert (problem.message, problem.role) == (GERMAN.session["nothing_to_begin"], "participant")
    assert "Essen Sie das Essen vom Löffel." in said[-4][0]
    assert visit.recordings()[0].configuration.language == "de"
    moved = ParticipantText("head_moved", {"moved_cm": "3.4", "most_cm": "2"})
    assert "3,4 cm" in GERMAN.format_for_vr(moved)
    visit.leave()


def test_tokens_persist_and_are_private(tmp_path: Path) -> None:
    path = tmp_path / "private" / "tokens.json"
    tokens = Tokens.load_or_create(path)
    assert Tokens.load_or_create(path) == tokens != Tokens.generate()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    for text in ("", '{"participant": "", "experimenter": "", "spectator": ""}'):
        path.write_text(text)
        with pytest.raises(ValueError, match="delete it to create new ones"):
            Tokens.load_or_create(path)
        assert path.read_text() == text
