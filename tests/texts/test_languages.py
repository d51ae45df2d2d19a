"""Laws of the texts that participants read: every language whole, a study's own texts before those brought along."""

import re
import stat
from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.models.human import SKIN_TONES
from avrgym.texts.texts import ENGLISH, FOLDER, ON_PAGE, Said, TextsError, normal, read_texts, shipped
from avrgym.vr.protocol.messages import Language, Phase, Problem, Ready, Stop
from avrgym.vr.server.access import Tokens
from visit import Visit, plan

GERMAN = read_texts("de")
ALIKE = {"anchor", "one_after_another", "seconds"}
"""What has no words."""
IN_VR_ALONE = ("wrong_height", "reach_")
"""Beginnings of the names of what nobody without a headset is told."""
CONTROLLER = re.compile(r"trigger|menu|\bA, B|Abzug|Menü", re.IGNORECASE)


def whole_file(direction: str = "rtl") -> str:
    """All texts in a language of our own: the English ones from behind, but for what stands in braces."""
    tables = {"session": ENGLISH.session, "page": ENGLISH.page}
    lines = [f'name = "Hsilgne"\ndirection = "{direction}"']
    for table, texts in tables.items():
        turned = {key: "".join(reversed(re.findall(r"\{\w+\}|.", text))) for key, text in texts.items()}
        lines += [f"[{table}]", *(f"{key} = '''{text}'''" for key, text in turned.items())]
    return "\n".join(lines)


def own(folder: Path, language: str, text: str) -> Path:
    (folder / FOLDER).mkdir(exist_ok=True)
    (folder / FOLDER / f"{language}.toml").write_text(text, "utf-8")
    return folder


@pytest.mark.parametrize("language", shipped())
def test_every_language_is_whole_and_its_own(language: str) -> None:
    texts = read_texts(language)
    assert set(SKIN_TONES) <= set(texts.page)
    for table in ("session", "page"):
        english, found = getattr(ENGLISH, table), getattr(texts, table)
        assert list(found) == list(english)
        alike = {key for key in english if found[key] == english[key]}
        assert language == "en" or alike <= ALIKE
    for key, text in texts.session.items():
        if CONTROLLER.search(text) and not key.endswith(ON_PAGE):
            on_page = texts.session.get(key + ON_PAGE, "" if key.startswith(IN_VR_ALONE) else text)
            assert not CONTROLLER.search(on_page), key


def test_a_study_brings_a_language_written_from_right_to_left(tmp_path: Path) -> None:
    texts = read_texts("ar-EG", own(tmp_path, "ar-EG", whole_file()))
    assert (texts.direction, texts.name) == ("rtl", "Hsilgne")
    assert texts.say(Said("trial", {"trial": "2", "trials": "8"})) == "8 fo 2 lairT"
    visit = Visit(tmp_path, replace(plan(), texts=texts))
    visit.session.greet(visit.heard.append, "participant", 0.0)
    told = visit.said(Language)[-1]
    assert (told.language, told.direction, told.words["stop"]) == ("ar-EG", "rtl", "tobor eht potS")
    visit.leave()


def test_a_study_changes_single_texts_of_a_language(tmp_path: Path) -> None:
    folder = own(tmp_path, "de", '[page]\nenter = "Los"\n[sentences]\n"a\\n b" = "c"')
    texts = read_texts("de", folder)
    assert (texts.page["enter"], texts.page["leave"]) == ("Los", GERMAN.page["leave"])
    assert texts.translate(" a b ") == "c"
    assert texts.lacking(["a b", "d", "d", " "]) == ["d"]
    assert normal("a\n  b ") == "a b"


@pytest.mark.parametrize(
    ("language", "text", "words"),
    [
        ("xx", None, "AVR Gym brings de, en"),
        ("../de", None, "allowed: a tag such as"),
        ("xx", "[session]\npractice = 'x'", "lacks trial, waiting, "),
        ("de", "[page]\nenterr = 'x'", "unknown enterr"),
        ("de", "[page]\nenter = ''", "lacks enter"),
        ("de", "[session]\ntrial = 'x {trial}'", "allowed: {trial}, {trials}"),
        ("de", "[session]\ntrial = '{trial.__class__} {trials}'", "other names in braces"),
        ("de", "[session]\ntrial = '{trial!r} {trials}'", "other names in braces"),
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
    with pytest.raises(TextsError, match=re.escape(words)) as refused:
        read_texts(language, folder)
    assert "\n" not in str(refused.value)


def test_a_session_speaks_one_language(tmp_path: Path) -> None:
    """Phases, problems and numbers; the experimenter reads English beside it."""
    visit = Visit(tmp_path, replace(plan(), texts=GERMAN))
    visit.go_to("trial")
    visit.tell(Ready(), Stop())
    said = [(phase.text, phase.page_text) for phase in visit.said(Phase)]
    german = {text.split("{")[0] for text in GERMAN.session.values() if text.split("{")[0]}
    for texts in said:
        assert all(any(text.startswith(begin) for begin in german) for text in texts)
    assert said[-1] == (GERMAN.session["stopped"], GERMAN.session["stopped_page"])
    problem = visit.said(Problem)[-1]
    assert (problem.message, problem.role) == (GERMAN.session["nothing_to_begin"], "participant")
    assert "Essen Sie das Essen vom Löffel." in said[-4][0]
    assert visit.recordings()[0].metadata["language"] == "de"
    moved = Said("head_moved", {"moved_cm": "3.4", "most_cm": "2"})
    assert "3,4 cm" in GERMAN.say(moved)
    visit.leave()


def test_tokens_outlast_a_restart_and_are_their_owners_alone(tmp_path: Path) -> None:
    path = tmp_path / "private" / "tokens.json"
    tokens = Tokens.kept(path)
    assert Tokens.kept(path) == tokens != Tokens.new()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    for text in ("", '{"participant": "", "experimenter": "", "spectator": ""}'):
        path.write_text(text)
        with pytest.raises(ValueError, match="without this file new ones are made"):
            Tokens.kept(path)
        assert path.read_text() == text
