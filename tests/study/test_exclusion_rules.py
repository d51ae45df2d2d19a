"""Exclusion rules of a plan: attention items, straight-lining and fast answers. Each exclusion is reported by name."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.analysis.plan import list_available_tests
from avrgym.analysis.reading.study_data import read_study_data
from avrgym.cli.main import app
from avrgym.study.design.toml_validation import DesignError
from avrgym.study.plan.analysis_plan import read_analysis_plan
from avrgym.study.plan.exclusion_rules import ExclusionRule, compute_answer_quality, find_rule_violations
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant

RULES = """
[[exclusion.rules]]
name = "wrong answer"
kind = "attention"
item = "L1"
allowed = [3]

[[exclusion.rules]]
name = "equal answers"
kind = "straight_lining"
max_share = 0.5

[[exclusion.rules]]
name = "fast answers"
kind = "response_time"
min_seconds = 1.0
"""


def study(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["study", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study with rules in its plan."""
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]', participants="4")
    study("freeze", folder)
    with open(folder / "plan.toml", "a") as file:
        file.write(RULES)
    return folder


def change_answers(store: StudyStore, pseudonym: str, **values: float) -> None:
    with store.database.write_transaction() as connection:
        for each in store.read_answers(pseudonym):
            hash_chain.update_row(connection, schema.ANSWER_TABLE, each.id, **values)


def test_participants_are_excluded_by_named_rules(folder: Path) -> None:
    """The answers of the first participant are in order; each other participant violates rules."""
    study("freeze", folder)
    with StudyStore(folder) as store:
        people = [enrol_with_consent(store, simulated=False) for _ in range(4)]
        for each in people:
            run_participant(store, each, simulated=False)
        change_answers(store, people[1], value=3)
        change_answers(store, people[2], response_time_s=0.25)
        change_answers(store, people[3], value=5, response_time_s=0.25)
        found = read_study_data(store)
        left_out = {
            each: {row.left_out for row in found.trials if row.participant == each and not row.practice}
            for each in people
        }
        assert left_out[people[0]] == {None}
        assert left_out[people[1]] == {
            "rule 'equal answers': all answers are equal in 100 % of the questionnaires; allowed: 50 %"
        }
        assert left_out[people[2]] == {
            "rule 'fast answers': the median time for an item is 0.25 s; allowed: at least 1 s"
        }
        (reason,) = left_out[people[3]]
        assert reason is not None
        assert reason.count("rule ") == 3
        assert "rule 'wrong answer': 2 of 2 answers to L1 are wrong; allowed: 0 %" in reason
        assert found.analysed_pseudonyms == {people[0]}
        assert [row.where for row in found.problems if "rule" in row.what] == people[1:]
        quality = compute_answer_quality(store, people[1])
        assert (quality.straight_lined_share, quality.median_response_s) == (1.0, 1.25)
    assert study("quality", folder).count("rule 'equal answers'") == 2


def test_without_rules_nobody_is_excluded(folder: Path) -> None:
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store, simulated=False)
        rule = ExclusionRule("fast", "response_time", min_seconds=60.0)
        assert find_rule_violations(store, [rule]) == []
        run_participant(store, pseudonym, simulated=False)
        assert [each.participant for each in find_rule_violations(store, [rule])] == [pseudonym]
        assert {row.left_out for row in read_study_data(store).trials} == {None}


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ('name = "a"\nkind = "attention"\nitem = "L9"\nallowed = [1]', "unknown item 'L9'; allowed: L1, L2"),
        ('name = "a"\nkind = "attention"\nitem = "L1"', "allowed is empty"),
        ('name = "a"\nkind = "straight_lining"\nitem = "L1"', "have no item"),
        ('name = "fast answers"\nkind = "straight_lining"', "used twice"),
        ('name = "a"\nkind = "other"', "other"),
    ],
)
def test_invalid_rules_are_refused(folder: Path, rule: str, message: str) -> None:
    with open(folder / "plan.toml", "a") as file:
        file.write(f"\n[[exclusion.rules]]\n{rule}\n")
    with StudyStore(folder) as store, pytest.raises(DesignError, match=message):
        read_analysis_plan(folder, store.design, list_available_tests(store.design))
