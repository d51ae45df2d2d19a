"""The design of a study: the default protocol of the paper, and errors with their line."""

import re
from pathlib import Path

import pytest

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text, read_design
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import create_study

TEXT = read_default_design_text()
TLX = """
[[questionnaires]]
name = "nasa_tlx"
when = "after_session"
order = "random"
items = [
    { id = "mental", text = "How mentally demanding was the task?", points = 21, low = "very low", high = "very high" },
    { id = "physical", text = "How physically demanding was it?", points = 21, low = "very low", high = "very high" },
    { id = "temporal", text = "How hurried was its pace?", points = 21, low = "very low", high = "very high" },
]
"""


def test_new_study_has_the_protocol_of_the_paper(tmp_path: Path) -> None:
    design = read_design(create_study(tmp_path / "a" / "study"))
    assert (design.participants, design.trial_steps, design.blind_experimenter) == (8, 200, False)
    assert design.tasks == ("Feeding", "Drinking", "ScratchItch", "BedBathing")
    assert design.robot_policy_pairs == (
        ("PR2", "original"), ("PR2", "revised"), ("Jaco", "original"), ("Jaco", "revised"),
    )  # fmt: skip
    assert design.list_items_at_moment("after_trial") == LIKERT_ITEMS
    assert {question.id for question in design.inclusion if not question.required} == {
        "epilepsy",
    }


def test_new_study_includes_people_with_motor_impairments() -> None:
    """Inclusion requires some means to signal stop, not the ability to press a button."""
    asked = {question.id: question.text.lower() for question in parse_design(TEXT).inclusion}
    assert "stop" in asked["stop"]
    assert "voice or another" in asked["stop"]
    for text in asked.values():
        assert not re.search(r"able-bodied|impairment|disab|trigger|controllers?|walk|hold", text), text


def test_all_settings_have_comments() -> None:
    for line in re.findall(r"^(\w+) = ", TEXT, re.MULTILINE):
        before = TEXT[: TEXT.index(f"\n{line} = ")].rpartition("\n\n")[2]
        assert "#" in before or "[" in before, f"{line} has no comment"


@pytest.mark.parametrize("held", ["study.toml", "study.db", "recordings", "private"])
def test_existing_study_is_not_overwritten(tmp_path: Path, held: str) -> None:
    (tmp_path / held).write_text("precious")
    with pytest.raises(StudyError, match=f"contains {held} already; choose another folder"):
        create_study(tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(held, "precious")]


MISTAKES = [
    ('tasks = ["Feeding"', 'tasks = ["Feding"', "unknown name 'Feding'; allowed: Feeding, Drinking"),
    ('["PR2", "Jaco"]', '["PR2",\n  "R2D2"]', "unknown name 'R2D2'; allowed: Jaco, PR2"),
    ('["PR2", "Jaco"]', '["PR2",\n  "PR2"]', "'PR2' is listed twice"),
    ('["PR2", "Jaco"]', "[]", "robots: Expected array of length >= 1"),
    ('"original", "revised"]', '"../secret"]', "'../secret' is not a valid name; allowed: the name of"),
    ('practice_policy = "revised"', 'practice_policy = "/etc"', "'/etc' is not a valid name"),
    ("participants = 8", "participants = 0", "participants: Expected int >= 1"),
    ("participants = 8", 'participants = "eight"', "participants: Expected int, got str"),
    ("trial_steps = 200", "trial_steps = 20.5", "trial_steps: Expected int, got float"),
    ("free_movement_s = 5.0", "free_movement_s = inf", "free_movement_s: Expected float <= 600"),
    ("free_movement_s = 5.0", "free_movement_s = nan", "free_movement_s"),
    ("seed = 0", "sead = 0", "unknown name 'sead'; allowed: title, participants, seed"),
    ("seed = 0", "seed =", "invalid TOML"),
    ("blind_experimenter = false", "blind_experimenter = 0", "Expected bool, got int"),
    ('id = "epilepsy"', 'id = "adult"', "'adult' is used twice"),
    ('id = "epilepsy"', 'id = "a/b"', "'a/b' is not a valid name"),
    ("required = true\n\n[[inclusion]]\nid = \"stop", "required = 1\n\n[[inclusion]]\nid = \"stop", "Expected bool"),
    ('id = "L4"', 'id = "L1"', "'L1' is used twice"),
    ('robot.", points = 7', 'robot.", points = 1', "points: Expected int >= 2"),
    ('{ id = "L3", ', "{ ", "missing required field id"),
    ('when = "after_trial"', 'when = "never"', "unknown value 'never'; allowed: before_session, after_trial"),
    ('order = "fixed"', 'order = "alphabetical"', "unknown value 'alphabetical'; allowed: fixed, random"),
    ('version = "1"', 'version = ""', "version: Expected str of length >= 1"),
    ('url = ""', 'url = "mysql://host"', 'allowed: "" or postgresql://user@host/name'),
]  # fmt: skip


@pytest.mark.parametrize(("good", "bad", "message"), MISTAKES, ids=[bad for _, bad, _ in MISTAKES])
def test_error_has_its_line(tmp_path: Path, good: str, bad: str, message: str) -> None:
    assert TEXT.count(good) >= 1
    text = TEXT.replace(good, bad, 1)
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(DesignError, match=re.escape(message)) as caught:
        read_design(path)
    name, line, _ = str(caught.value).removeprefix(str(tmp_path) + "/").split(":", 2)
    assert name == "study.toml"
    begin = TEXT[: TEXT.index(good)].count("\n") + 1
    assert begin <= int(line) <= begin + bad.count("\n") + 1


def test_missing_setting_is_reported() -> None:
    with pytest.raises(DesignError, match=r"study.toml:\d+: Object missing required field seed"):
        parse_design(TEXT.replace("seed = 0", ""))


def test_binary_file_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_bytes(b"title = \xff")
    with pytest.raises(DesignError, match="not a UTF-8 text"):
        read_design(tmp_path / "study.toml")


# Questionnaires and blinding


def test_added_questionnaires_have_their_moments() -> None:
    design = parse_design(TEXT + TLX)
    assert [item.id for item in design.list_items_at_moment("after_trial")] == ["L1", "L2", "L3", "L4"]
    assert design.list_items_at_moment("before_session") == ()
    orders = {
        tuple(item.id for item in design.list_items_at_moment("after_session", seed)) for seed in range(30)
    }
    assert orders > {("mental", "physical", "temporal")}
    assert all(set(order) == {"mental", "physical", "temporal"} for order in orders)
    assert design.list_items_at_moment("after_session", 4) == design.list_items_at_moment("after_session", 4)


def test_the_item_about_fatigue_needs_only_its_comment_marks_removed() -> None:
    start = TEXT.index("# [[questionnaires]]")
    end = TEXT.index("\n\n", start)
    added = re.sub(r"(?m)^# ", "", TEXT[start:end])
    (item,) = parse_design(TEXT[:start] + added + TEXT[end:]).list_items_at_moment("after_break")
    assert (item.text, item.points) == ("How tired are you now?", 11)


def test_ids_are_unique_in_all_questionnaires() -> None:
    with pytest.raises(DesignError, match="'L1' is used twice"):
        parse_design(TEXT + TLX.replace('"mental"', '"L1"'))


def test_blinded_experimenter_sees_letters() -> None:
    blind = TEXT.replace("blind_experimenter = false", "blind_experimenter = true")
    designs = [parse_design(blind.replace("seed = 0", f"seed = {seed}")) for seed in range(20)]
    assert {design.choose_displayed_policy("revised", practice=False) for design in designs} == {"A", "B"}
    for design in designs:
        assert {design.choose_displayed_policy(policy, practice=False) for policy in design.policies} == {
            "A",
            "B",
        }
        assert design.choose_displayed_policy("revised", practice=True) == "practice"
    assert parse_design(TEXT).choose_displayed_policy("revised", practice=False) == "revised"


def test_goals_furniture_and_reporting_are_checked():
    text = read_default_design_text()
    design = parse_design(text)
    assert {*design.goals} == {"Feeding", "Drinking"}
    assert design.furniture == RealFurniture()
    for old, new, words in (
        ("Feeding = ", "Feding = ", "unknown name 'Feding'; allowed: Feeding"),
        ("seat_height_m = 0.485", "seat_height_m = 48.5", "seat_height_m is 48.5; allowed: 0.3 to 0.7"),
        ("seat_back_deg = 90.0", "seat_angle = 90.0", "unknown name 'seat_angle'; allowed: seat_height_m"),
        ('recruitment = ""', "recruitment = 3", "recruitment"),
    ):
        line = text[: text.index(old)].count("\n") + 1
        with pytest.raises(DesignError, match=words) as refused:
            parse_design(text.replace(old, new))
        assert abs(int(str(refused.value).split(":")[1]) - line) <= 2
