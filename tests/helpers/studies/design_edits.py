"""A study with all fields of the design, and an edit of each field."""

from pathlib import Path
from typing import NamedTuple

from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.questionnaires.jian_trust import JIAN_TRUST
from avrgym.questionnaires.nasa_tlx import NASA_TLX
from avrgym.study.design.design import read_default_design_text
from avrgym.study.people.participants import enrol_participant, record_consent, record_inclusion_answers
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import eligible_answers, run_participant

QUESTIONNAIRES = """\
[[questionnaires]]
name = "feeling"
when = ["before_session", "after_session"]
items = [
    { id = "F1", text = "I feel well.", points = 3, low = "no", high = "yes", labels = ["no", "so so", "yes"] },
    { id = "F2", text = "I am tired.", points = 7, low = "no", high = "yes" },
]

[[questionnaires]]
use = "nasa-tlx"
when = "after_session"
weights = { mental = 3, physical = 3, temporal = 3, performance = 3, effort = 2, frustration = 1 }

[[questionnaires]]
use = "jian-trust"
when = "after_session"

[[stop_rules]]
item = "F2"
at_least = 6
then = "pause"

[goals]"""
GERMAN = {
    "I feel well.": "Mir geht es gut.",
    "I am tired.": "Ich bin müde.",
    "I am very tired.": "Ich bin sehr müde.",
    "no": "nein",
    "so so": "geht so",
    "quite": "ziemlich",
    "yes": "ja",
    "The robot failed.": "Der Roboter hat versagt.",
    "I liked it.": "Es gefiel mir.",
    "Have you slept?": "Haben Sie geschlafen?",
    "Are you 21 years old or older?": "Sind Sie 21 Jahre alt oder älter?",
    "Open your mouth.": "Öffnen Sie den Mund.",
    **{f"Statement {number}.": f"Aussage {number}." for number in range(1, 13)},
    "Another statement.": "Eine andere Aussage.",
    **{
        words: f"{words} (auf Deutsch)"
        for instrument in (NASA_TLX, JIAN_TRUST)
        for item in instrument.items
        for words in (item.text, item.low_label, item.high_label, *item.option_labels)
        if words
    },
}
TRUST = "".join(f'trust_{number} = "Statement {number}."\n' for number in range(1, 13))
L1 = "The robot successfully assisted me with the task."
L3 = 'text = "I felt I would be safe if this were a real robot.", points = 7, low = "strongly disagree", '
L4 = '    { id = "L4", text = "The robot moved with appropriate speed.", points = 7, low = "strongly disagree", '
DESIGN, DE, JIAN = "study.toml", "texts/de.toml", "instruments/jian-trust.toml"


class Edit(NamedTuple):
    """An edit of a file, and the words that the finding must contain: the field and both values.

    ``is_error``: the check reports an error; ``by``: another edit makes this one too.
    """

    before: str
    after: str
    field: str
    was: str
    then: str
    file: str = DESIGN
    is_error: bool = True
    by: str = ""

    @property
    def where(self) -> str:
        """The file that the finding names. Texts of instruments are part of the design."""
        return DESIGN if self.file == JIAN else self.file


EDITS = {
    "title": Edit(
        'title = "Assistive VR Gym: ', 'title = "', "title", '"Assistive VR', '"real', is_error=False
    ),
    "participants": Edit("participants = 8", "participants = 9", "participants", "8", "9", is_error=False),
    "max_held_share": Edit(
        "max_held_share = 0.05", "max_held_share = 0.5", "max_held_share", "0.05", "0.5", is_error=False
    ),
    "free_movement_s": Edit(
        "free_movement_s = 5.0", "free_movement_s = 4.0", "free_movement_s", "5.0", "4.0"
    ),
    "blind_experimenter": Edit(
        "blind_experimenter = false", "blind_experimenter = true", "blind_experimenter", "false", "true"
    ),
    "force_guard": Edit("force_guard = true", "force_guard = false", "force_guard", "true", "false"),
    "withdraw_after_success": Edit(
        "withdraw_after_success = true",
        "withdraw_after_success = false",
        "withdraw_after_success",
        "true",
        "false",
    ),
    "headset_check": Edit("headset_check = true", "headset_check = false", "headset_check", "true", "false"),
    "measure_reach": Edit("measure_reach = false", "measure_reach = true", "measure_reach", "false", "true"),
    "ask_functioning": Edit(
        "ask_functioning = false", "ask_functioning = true", "ask_functioning", "false", "true"
    ),
    "an item's words": Edit(
        L1, "The robot failed.", "questionnaires.likert.items.L1.text", f'"{L1}"', '"The robot failed."'
    ),
    "an item's points": Edit(
        'assisted me in VR.", points = 7',
        'assisted me in VR.", points = 5',
        "questionnaires.likert.items.L2.points",
        "7",
        "5",
    ),
    "the end of a scale": Edit(
        L3 + 'high = "strongly agree"',
        L3.replace("disagree", "agree") + 'high = "strongly disagree"',
        "questionnaires.likert.items.L3.low",
        '"strongly disagree"',
        '"strongly agree"',
    ),
    "the other end": Edit(
        "",
        "",
        "questionnaires.likert.items.L3.high",
        '"strongly agree"',
        '"strongly disagree"',
        by="the end of a scale",
    ),
    "an item more": Edit(
        L4,
        '    { id = "L5", text = "I liked it.", points = 7, low = "no", high = "yes" },\n' + L4,
        "questionnaires.likert.items.L5",
        "missing",
        '{"text": "I liked it."',
    ),
    "the order of items": Edit(
        "",
        "",
        "questionnaires.likert.order of items",
        '["L1", "L2", "L3", "L4"]',
        '["L1", "L2", "L3", "L5", "L4"]',
        by="an item more",
    ),
    "a random order": Edit(
        'order = "fixed"\nitems',
        'order = "random"\nitems',
        "questionnaires.likert.order",
        '"fixed"',
        '"random"',
    ),
    "an item's labels": Edit(
        '"so so"',
        '"quite"',
        "questionnaires.feeling.items.F1.labels",
        '["no", "so so", "yes"]',
        '["no", "quite", "yes"]',
    ),
    "words about sessions": Edit(
        '"I am tired."',
        '"I am very tired."',
        "questionnaires.feeling.items.F2.text",
        '"I am tired."',
        '"I am very tired."',
    ),
    "the moment": Edit(
        'when = ["before_session", "after_session"]',
        'when = "before_session"',
        "questionnaires.feeling.when",
        '["before_session", "after_session"]',
        '["before_session"]',
    ),
    "weights": Edit(
        "mental = 3, physical = 3",
        "mental = 5, physical = 1",
        "questionnaires.nasa-tlx.weights.mental",
        "3",
        "5",
    ),
    "a stop rule": Edit("at_least = 6", "at_least = 5", "stop_rules.F2.at_least", "6.0", "5.0"),
    "what it does": Edit('then = "pause"', 'then = "end"', "stop_rules.F2.then", '"pause"', '"end"'),
    "a goal": Edit(
        "Eat the food from the spoon.",
        "Open your mouth.",
        "goals.Feeding",
        '"Eat the food',
        '"Open your mouth."',
    ),
    "the seat's height": Edit(
        "seat_height_m = 0.485", "seat_height_m = 0.4", "furniture.seat_height_m", "0.485", "0.4"
    ),
    "its depth": Edit("seat_depth_m = 0.41", "seat_depth_m = 0.5", "furniture.seat_depth_m", "0.41", "0.5"),
    "its back": Edit(
        "seat_back_deg = 90.0", "seat_back_deg = 80.0", "furniture.seat_back_deg", "90.0", "80.0"
    ),
    "the mattress": Edit(
        "mattress_height_m = 0.55", "mattress_height_m = 0.6", "furniture.mattress_height_m", "0.55", "0.6"
    ),
    "its back too": Edit(
        "mattress_back_deg = 60.0", "mattress_back_deg = 50.0", "furniture.mattress_back_deg", "60.0", "50.0"
    ),
    "breaks": Edit(
        "break_every_minutes = 0.0",
        "break_every_minutes = 20.0",
        "sessions.break_every_minutes",
        "0.0",
        "20.0",
    ),
    "time in VR": Edit(
        "max_headset_minutes = 0.0",
        "max_headset_minutes = 45.0",
        "sessions.max_headset_minutes",
        "0.0",
        "45.0",
    ),
    "streams out": Edit("send = false", "send = true", "streams.send", "false", "true"),
    "streams in": Edit(
        "receive = {}",
        "receive = { heart = \"type='ECG'\" }",
        "streams.receive.heart",
        "missing",
        "\"type='ECG'\"",
    ),
    "a question": Edit(
        "Are you 18 years old or older?",
        "Are you 21 years old or older?",
        "inclusion.adult.text",
        '"Are you 18',
        '"Are you 21',
    ),
    "the answer that is required": Edit(
        'fluent in English?"\nrequired = true',
        'fluent in English?"\nrequired = false',
        "inclusion.english.required",
        "true",
        "false",
    ),
    "a question more": Edit(
        '[[inclusion]]\nid = "epilepsy"',
        '[[inclusion]]\nid = "slept"\ntext = "Have you slept?"\nrequired = true\n\n[[inclusion]]\nid = "epilepsy"',
        "inclusion.slept",
        "missing",
        '{"text": "Have you slept?"',
    ),
    "a translation": Edit('"ja"', '"jawohl"', "sentences.yes", '"ja"', '"jawohl"', DE),
    "a text of the program": Edit(
        '"Warten Sie."', '"Warten Sie bitte."', "session.waiting", '"Warten Sie."', '"Warten Sie bitte."', DE
    ),
    "an instrument's words": Edit(
        "Statement 1.",
        "Another statement.",
        "questionnaires.jian-trust.items.trust_1.text",
        '"Statement 1."',
        '"Another statement."',
        JIAN,
    ),
}


def make_edited_study(folder: Path) -> Path:
    """Create a study in two languages with questionnaires of all kinds, a stop rule and its own policy."""
    text = read_default_design_text().replace("[goals]", QUESTIONNAIRES)
    for before, after in {
        'tasks = ["Feeding", "Drinking", "ScratchItch", "BedBathing"]': 'tasks = ["Feeding"]',
        'policies = ["original", "revised"]': 'policies = ["original", "mine"]',
        'languages = ["en"]': 'languages = ["en", "de"]',
    }.items():
        assert text.count(before) == 1
        text = text.replace(before, after)
    sentences = "".join(f'"{english}" = "{german}"\n' for english, german in GERMAN.items())
    for name in ("texts", "instruments", "mine"):
        (folder / name).mkdir(parents=True)
    (folder / DE).write_text(
        f'[session]\nwaiting = "Warten Sie."\n\n[sentences]\n{sentences}', encoding="utf-8"
    )
    (folder / JIAN).write_text(TRUST)
    for robot in ("Jaco", "PR2"):
        packaged = find_packaged_policies(f"avrgym/Feeding{robot}-v1")
        (folder / "mine" / f"Feeding{robot}.safetensors").write_bytes(packaged["revised"].read_bytes())
    (folder / DESIGN).write_text(text)
    return folder


def edit(folder: Path, *names: str) -> None:
    """Apply edits to a study's folder."""
    for each in (EDITS[name] for name in names if not EDITS[name].by):
        text = (folder / each.file).read_text(encoding="utf-8")
        assert text.count(each.before) == 1, each.field
        (folder / each.file).write_text(text.replace(each.before, each.after), encoding="utf-8")


def participate(
    store: StudyStore, language: str, *, simulated: bool = True, trials: int | None = None
) -> str:
    """Run a participant's session in a language."""
    pseudonym = enrol_participant(store, "woman", age_years=30, language=language, simulated=simulated)
    record_consent(store, pseudonym)
    assert record_inclusion_answers(store, pseudonym, eligible_answers(store))
    run_participant(store, pseudonym, trials, simulated=simulated)
    return pseudonym
