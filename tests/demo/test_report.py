import base64
from pathlib import Path

import pytest
from msgspec.structs import replace

from avrgym.demo.report import summarise, telling_moment_s, write_report
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item
from avrgym.recording.reader import read_recording
from avrgym.recording.schema import Answer, Control, Event, Latency, Outcome, TrackingFrame
from avrgym.recording.writer import RecordingWriter
from helpers.browser.html_page import Page
from helpers.studies.configurations import configuration

CONFIGURATION = configuration(
    environment="avrgym/FeedingJaco-v1", reward_weights={"distance": 2.0, "action": 0.01}, items=LIKERT_ITEMS
)
HOSTILE = "<script>alert('1')</script>\"&"
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


def control(step: int, success: bool = False) -> Control:
    terms = {"distance": -0.5, "action": -1.0, "spilled": 0.0}
    return Control(step, [0.0], [0.0], -1.01, terms, success, 0.5 - step / 10, 2.0 * step)


def record(
    path: Path, recorded=CONFIGURATION, steps: int = 4, complete: bool = True, text: str = "steady"
) -> Path:
    writer = RecordingWriter(path, recorded)
    for sequence in (0, 1, 2, 4):
        frame = TrackingFrame(sequence, sequence * 10.0, sequence / 50, applied=True, held=sequence == 2)
        writer.write("/tracking", sequence * 20_000_000, frame)
    for step in range(steps):
        writer.write("/control", step * 100_000_000, control(step, success=step == steps - 1))
    for value, item in enumerate(LIKERT_ITEMS, start=3):
        writer.write("/answers", 20_000_000_000, Answer(item.id, value, value / 4))
    stages = [[1.0, 1.0], [3.0, 5.0], [9.0, 9.0], [0.0, 0.0], [3.0, 5.0], [44.0, 40.0]]
    writer.write("/latency", 1_000_000_000, Latency([0, 1], *stages))
    writer.write("/events", 1_500_000_000, Event("reconnected", text))
    writer.close(Outcome(result="completed", success=True) if complete else None)
    return path


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "feeding_jaco-view.png"
    path.write_bytes(PIXEL)
    return path


def test_a_trial_in_figures(tmp_path):
    summary = summarise(read_recording(record(tmp_path / "a.mcap")))
    assert summary.reward == pytest.approx(-4.04)
    assert (summary.success, summary.steps) == (True, 4)
    assert (summary.closest_m, summary.peak_force_n) == (pytest.approx(0.2), 6.0)
    assert (summary.frames, summary.frames_held, summary.frames_missing) == (4, 1, 1)
    assert summary.frame_rate_hz == pytest.approx(37.5)
    assert summary.latency_ms["total_ms"]["p50"] == pytest.approx(60.0)


def test_the_report_says_what_happened(tmp_path, picture):
    page = Page(write_report(tmp_path, [record(tmp_path / "a.mcap")], [picture], "One trial"))
    expected = {
        "One trial",
        "1 recording, of which 0 practice and 0 incomplete.",
        "SIMULATED PARTICIPANT",
        "Trial 1: avrgym/FeedingJaco-v1, revised policy",
        "−4.04",
        "0.20 m",
        "6.00 N",
        "1 frame of 4",
        "60 ms, 95 % within 60: pose 1, up 4, simulation 9, sending 0, down 4, drawing 42",
        "distance −2.00 2.00 −4.00",
        "spilled 0.00",
        "3 of 7 0.75 s",
        "1.50 s reconnected 1 steady",
        "feeding jaco view",
        *(item.text for item in LIKERT_ITEMS),
    }
    words = " ".join(page.text.split())
    assert {text for text in expected if text not in words} == set()
    assert [tag for tag, _ in page.tags].count("svg") == 3


def test_the_report_leads_with_what_happened_in_each_trial(tmp_path, picture):
    trials = [
        record(tmp_path / "a.mcap", replace(CONFIGURATION, goal="Eat the food from the spoon.")),
        record(tmp_path / "b.mcap", replace(CONFIGURATION, environment="avrgym/BedBathingPR2-v1"), steps=0),
    ]
    moments = {trials[0]: picture}
    written = write_report(tmp_path, trials, [], "Two trials", moments).read_text()
    lead = written[written.index("What happened") : written.index('<article id="trial-1"')]
    first, second = lead.split("<h3>")[1:]
    for words in (
        "FeedingJaco",
        "Eat the food",
        "yes, after 0 s",
        "at most 6.0 N, mean 3.0 N",
        "3 of 7: The robot",
    ):
        assert words in first
    assert "data:image/png" in first
    assert "BedBathingPR2" in second
    assert "<img" not in second
    assert "not recorded" in second


def test_the_telling_moment_is_the_success_or_else_the_nearest(tmp_path):
    succeeded = read_recording(record(tmp_path / "a.mcap"))
    assert telling_moment_s(succeeded) == pytest.approx(0.3)
    assert telling_moment_s(read_recording(record(tmp_path / "b.mcap", steps=0))) == 0.0


def test_answers_stand_in_the_words_that_they_were_asked_in(tmp_path):
    item = Item("L1", text="How demanding?", points=21, low="very low", high="very high")
    path = record(tmp_path / "a.mcap", replace(CONFIGURATION, items=(item, *LIKERT_ITEMS[1:])))
    words = " ".join(Page(write_report(tmp_path, [path], [], "One trial")).text.split())
    assert "How demanding? 1 (very low) to 21 (very high) 3 of 21" in words
    assert "1 (strongly disagree) to 7 (strongly agree) 4 of 7" in words


def test_the_page_is_one_file_with_unique_ids_and_working_references(tmp_path, picture):
    trials = [record(tmp_path / f"{number}.mcap") for number in range(3)]
    page = Page(write_report(tmp_path, trials, [picture, picture], "Three trials"))
    ids = page.attributes("id")
    assert len(set(ids)) == len(ids)
    references = page.attributes("href") + page.attributes("src") + page.attributes("xlink:href")
    assert {reference.partition(",")[0] for reference in references if reference[0] != "#"} == {
        "data:image/png;base64"
    }
    assert {reference[1:] for reference in references if reference[0] == "#"} <= set(ids)
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.tags}
    assert list((tmp_path / "report").iterdir()) == [tmp_path / "report" / "index.html"]


def test_the_same_input_gives_the_same_bytes(tmp_path, picture):
    trials = [record(tmp_path / f"{number}.mcap") for number in range(2)]
    first = write_report(tmp_path / "first", trials, [picture], "Twice").read_bytes()
    assert write_report(tmp_path / "second", trials, [picture], "Twice").read_bytes() == first


def test_hostile_text_stays_text(tmp_path):
    hostile = replace(CONFIGURATION, environment=HOSTILE, policy=HOSTILE)
    path = write_report(tmp_path, [record(tmp_path / "a.mcap", hostile, text=HOSTILE)], [], HOSTILE)
    assert HOSTILE not in path.read_text()
    page = Page(path)
    assert page.text.count(HOSTILE) == 8
    assert "script" not in {tag for tag, _ in page.tags}


def test_a_person_is_not_marked_as_simulated(tmp_path):
    trials = [
        record(tmp_path / "a.mcap", replace(CONFIGURATION, simulated=False)),
        record(tmp_path / "b.mcap"),
    ]
    assert "SIMULATED" not in Page(write_report(tmp_path / "a", trials[:1], [], "Person")).text
    both = Page(write_report(tmp_path / "both", trials, [], "Both")).text
    assert "1 of 2 trials here had no person" in both


def test_what_is_missing_is_said(tmp_path):
    empty = tmp_path / "empty.mcap"
    RecordingWriter(empty, CONFIGURATION).close()
    foreign = tmp_path / "foreign.mcap"
    foreign.write_bytes(b"foreign")
    trials = [
        record(tmp_path / "a.mcap", replace(CONFIGURATION, practice=True), complete=False),
        empty,
        foreign,
        tmp_path / "missing.mcap",
    ]
    words = " ".join(Page(write_report(tmp_path, trials, [], "Accidents")).text.split())
    assert "4 recordings, of which 1 practice and 4 incomplete." in words
    assert "foreign.mcap: not a recording" in words
    assert "No such file or directory: 'missing.mcap'" in words
    assert "No step of the robot was recorded." in words
    assert "No answers were recorded." in words


def test_a_report_of_nothing_is_a_page(tmp_path):
    assert "0 recordings" in Page(write_report(tmp_path, [], [], "Nothing")).text


def test_a_picture_of_an_unknown_type_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"scene\.gif: not a picture; allowed: \.png, \.jpg"):
        write_report(tmp_path, [], [tmp_path / "scene.gif"], "Picture")
    assert not (tmp_path / "report").exists()
