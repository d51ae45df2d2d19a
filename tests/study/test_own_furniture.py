"""A participant's own wheelchair and bed."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest
from playwright.sync_api import expect
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.models.furniture.real_furniture import FurniturePoint, RealFurniture
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.dashboard.displayed_data import make_displayed_participant
from avrgym.study.people.furniture import read_own_furniture, record_own_furniture
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.sessions.study_visit import StudyVisit, plan_session
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import EmulatedHeadset
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol.messages import FurniturePointMark, XRPose
from avrgym.vr.server.live_server import LiveServer
from helpers.browser.accessibility import violations
from helpers.browser.journey import TIMEOUT_S, skip_drawing, wait_for_phase
from helpers.studies.small_studies import enrol_with_consent, small_study
from helpers.vr.visit import Visit


@pytest.fixture(autouse=True)
def sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


def test_own_furniture_applies_in_the_sessions_of_its_owner_only(tmp_path: Path) -> None:
    """It replaces the station's furniture; another participant gets that of the station."""
    own, station = RealFurniture(seat_height_m=0.6, mattress_back_deg=30.0), RealFurniture(seat_height_m=0.4)
    with StudyStore(small_study(tmp_path)) as store:
        owner, other = (enrol_with_consent(store) for _ in range(2))
        record_own_furniture(store, owner, RealFurniture(seat_height_m=0.5))
        record_own_furniture(store, owner, own)
        assert (plan_session(store, owner).furniture, plan_session(store, other).furniture) == (
            own,
            store.design.furniture,
        )
        assert make_displayed_participant(store, owner).furniture == own
        for name, expected in ((owner, own), (other, station)):
            sessions = StudySessions(store, lambda _: None, first=name, furniture=station)
            assert sessions._session is not None
            assert sessions._session.plan.furniture == expected
            sessions.close(0.0)


def test_an_experimenter_measures_it_with_a_controller(tmp_path: Path) -> None:
    """Without a controller and with impossible points nothing changes. Then the participant is measured again."""
    with StudyStore(small_study(tmp_path / "study")) as store:
        name = enrol_with_consent(store)
        with StudyVisit(store, name) as visit:
            plan = visit.plan_remaining_trials()
            attended = Visit(tmp_path, plan, make=lambda send: visit.create_session(plan, send))
            attended.send(FurniturePointMark("front"))
            assert "no controller is tracked" in attended.problems[-1]
            attended.go_to("calibration")
            attended.session._state.set_torso_height(0.55)
            points: tuple[tuple[FurniturePoint, float, float], ...] = (
                ("front", 0.5, 0.0), ("rear", 0.44, 0.4), ("top", 1.0, 0.5),
            )  # fmt: skip
            for top_m in (0.44, 1.0):
                for point, height_m, back_m in points:
                    touched = (0.1, top_m if point == "top" else height_m, back_m)
                    pose = XRPose(touched, (0.0, 0.0, 0.0, 1.0))
                    attended.send(
                        msgspec.structs.replace(attended.frame(), right=pose), FurniturePointMark(point)
                    )
                    if top_m < 1.0:
                        assert attended.session.plan.furniture == store.design.furniture
                if top_m < 1.0:
                    assert "the points do not measure a seat" in attended.problems[-1]
            assert not attended.session._state.torso_height_known
            assert (
                "measured: 0.5 m high, 0.404 m deep, back at 79.9°, tilted by 8.5°" in attended.problems[-1]
            )
            attended.leave()
        measured = read_own_furniture(store, name)
        assert measured is not None
        assert measured.seat_tilt_deg == pytest.approx(8.53, abs=0.01)
        assert plan_session(store, name).furniture == measured


@pytest.mark.slow
@pytest.mark.usefixtures("relaxed_limits")
def test_an_experimenter_measures_it_on_the_dashboard_in_a_browser(tmp_path: Path) -> None:
    """Seat, tilt, back and headrest from four points; the controller in the headset's browser touches them."""
    expect.set_options(timeout=1000 * TIMEOUT_S)
    buttons: dict[str, tuple[float, float]] = {
        "Front edge, or mattress at the thighs": (0.5, 0.0),
        "Front of the headrest or pillow": (1.1, 0.466),
        "Rear edge, where the back begins": (0.44, 0.4),
        "Top of the back": (1.0, 0.5),
    }
    with (
        StudyStore(small_study(tmp_path / "study")) as store,
        ThreadPoolExecutor(1) as workers,
        LiveServer(
            lambda send: StudySessions(store, send, workers, first=enrol_with_consent(store)),
            "127.0.0.1",
            0,
            study=lambda tokens, sessions: make_dashboard_app(store, tokens, sessions),
        ) as server,
        EmulatedHeadset(server.participant_url, 320, 180) as headset,
    ):
        skip_drawing(headset)
        participant = SimulatedParticipant(sample_participant_traits("woman", 5), 5)
        headset.set_poses(participant.make_tracking_frame(0.0, moving=False))
        headset.enter_vr()
        wait_for_phase(headset, "calibration")
        browser = headset.page.context.browser
        assert browser is not None
        dashboard = browser.new_page()
        dashboard.goto(server.list_page_urls("dashboard?detail=light", server.tokens.experimenter)[0])
        dashboard.get_by_text("Measure seat or bed with a controller").click()
        assert violations(dashboard) == []
        for label, (height_m, back_m) in buttons.items():
            touched = {"position": (0.1, height_m, back_m), "orientation": (0.0, 0.0, 0.0, 1.0)}
            headset.call_emulator("setPoses", {"right": touched})
            headset.wait_for_frames(5)
            dashboard.get_by_role("button", name=label).click()
            seen = f"{height_m:.2f} m above" if label != "Top of the back" else "measured: 0.5 m high"
            expect(dashboard.get_by_text(seen)).to_be_visible()
        dashboard.screenshot(path=tmp_path / "measured.png", full_page=True)
        (name,) = (each.pseudonym for each in store.read_participants())
        measured = read_own_furniture(store, name)
    assert measured is not None
    assert measured.describe(seated=True) == (
        "0.5 m high, 0.404 m deep, back at 79.9°, tilted by 8.5°, headrest 0.051 m in front"
    )


def test_the_command_line_stores_measures_and_refuses_impossible_ones(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path)) as store:
        name = enrol_with_consent(store)
        for change, words in (
            ("seat_height_m=3", "allowed: 0.3 to 0.7"),
            ("legs=4", "allowed: seat_height_m"),
        ):
            refused = CliRunner().invoke(app, ["study", "furniture", str(tmp_path), name, "--set", change])
            assert refused.exit_code == 1
            assert words in " ".join(refused.output.split())
        assert read_own_furniture(store, name) is None
        arguments = ["study", "furniture", str(tmp_path), name, "--set", "seat_back_deg=80"]
        assert CliRunner().invoke(app, arguments).exit_code == 0
        assert read_own_furniture(store, name) == RealFurniture(seat_back_deg=80.0)
