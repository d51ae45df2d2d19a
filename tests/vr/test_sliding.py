"""Laws of sliding on the seat: the seat follows smoothly after rest, and recordings do not change."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from avrgym.models import human
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.vr.protocol.messages import TICK_S, Scene, WorldMotion
from avrgym.vr.protocol.webxr import Registration, compute_head_pose
from avrgym.vr.session import events
from avrgym.vr.tracking.sliding import SEAT_SPEED_M_S, SlidingMonitor
from helpers.vr.visit import Visit, plan

SLIDES = ((0.3, 0.0), (-0.3, 0.0), (0.0, -0.3), (0.15, 0.2))


class Slider(Visit):
    """A participant who can slide on their seat, who else keeps still."""

    def sits(self) -> None:
        self.go_to("free_before")
        self.pose_rad = self.participant._rest_rad

    def slide(self, x_m: float, y_m: float) -> None:
        """Slide in the world's directions, at 1 m/s."""
        place = self.session.registration
        assert place is not None
        yaw_rad = self.participant._room.yaw_rad - place.yaw_rad
        turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
        x_m, y_m = (turn @ [x_m, y_m]).tolist()
        for _ in range(30):
            room = self.participant._room
            self.participant._room = replace(room, origin_w=room.origin_w - [x_m / 30.0, y_m / 30.0, 0.0])
            self.tick()

    def missed_m(self) -> float:
        """How far the head of the simulated body is from where it is tracked."""
        registration = self.session.registration
        frame = self.session._state.tracking._followed
        assert registration is not None
        assert frame is not None
        assert frame.tracking.head is not None
        posture = self.session.world.scene_config.posture
        reached_w = SlidingMonitor(self.session.person, posture).compute_head_centre_w(
            self.session.world.joint_targets_rad
        )
        return float(np.linalg.norm(compute_head_pose(registration, frame.tracking.head).pos_w - reached_w))

    @property
    def place(self) -> Registration:
        registration = self.session.registration
        assert registration is not None
        return registration


def sitting(folder: Path, **changes: float) -> Slider:
    visit = Slider(folder, plan(**({"free_movement_s": 20.0} | changes)))  # type: ignore[arg-type]
    visit.sits()
    visit.tick(150)
    return visit


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("way_m", SLIDES, ids=str)
def test_after_a_slide_the_head_is_where_it_is_tracked(tmp_path: Path, way_m: tuple[float, float]) -> None:
    visit = sitting(tmp_path)
    before = visit.place
    visit.slide(*way_m)
    visit.tick(20)
    slid_m = visit.missed_m()
    visit.tick(100)
    places = []
    for _ in range(700):
        visit.tick()
        places.append(visit.place.origin_w)
    print(
        f"\nslid by {np.hypot(*way_m):.2f} m: head missed by {slid_m:.3f} m, then by {visit.missed_m():.3f} m"
    )
    assert slid_m > 0.03
    assert visit.missed_m() < 0.02
    steps_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps_m.max() < 1.01 * SEAT_SPEED_M_S * TICK_S
    assert not np.array_equal(visit.place.origin_w, before.origin_w)
    assert visit.place.origin_w[2] == before.origin_w[2]
    (placed,) = visit.received(WorldMotion)
    assert placed.xr_from_world.position == pytest.approx(visit.place.xr_from_world().position, abs=1e-6)


@pytest.mark.slow
def test_who_leans_stays_where_they_are(tmp_path: Path) -> None:
    visit = sitting(tmp_path)
    before = visit.place
    for lean_deg in (10.0, 20.0, 25.0):
        leaning_rad = visit.participant._rest_rad.copy()
        leaning_rad[human.JOINT_INDEX["waist_x"]] = np.radians(lean_deg)
        visit.pose_rad = leaning_rad
        visit.tick(200)
    assert visit.missed_m() < 0.02
    assert visit.place is before
    assert visit.received(WorldMotion) == []


@pytest.mark.slow
def test_who_gets_up_takes_no_seat_along(tmp_path: Path) -> None:
    visit = sitting(tmp_path)
    before = visit.place
    room = visit.participant._room
    visit.participant._room = replace(room, origin_w=room.origin_w - [0.3, 0.0, 0.4])
    visit.tick(400)
    assert visit.place is before


@pytest.mark.slow
def test_who_comes_meanwhile_is_told_where_the_world_goes(tmp_path: Path) -> None:
    visit = sitting(tmp_path)
    visit.slide(0.3, 0.0)
    visit.tick(300)
    late: list[object] = []
    visit.session.send_initial_state(late.append, "spectator", visit.now_s)
    (scene,) = (each for each in late if isinstance(each, Scene))
    (placed,) = (each for each in late if isinstance(each, WorldMotion))
    assert scene.xr_from_world == visit.place.xr_from_world()
    assert 0.0 < placed.seconds < 6.0
    assert placed.xr_from_world.position == pytest.approx(
        visit.received(WorldMotion)[0].xr_from_world.position
    )


@pytest.mark.slow
def test_a_slide_during_a_trial_is_recorded_and_verifies_bit_by_bit(tmp_path: Path) -> None:
    visit = Slider(tmp_path, plan(trial_steps=90, free_movement_s=0.1))
    visit.go_to("trial")
    visit.pose_rad = visit.participant._rest_rad
    visit.slide(0.3, 0.0)
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    recording = read_recording(visit.session.recordings[0])
    places = [record.xr_from_world.position for _, record in recording.messages_by_topic["/placement"]]
    assert len(places) > 300
    assert places[-1] == pytest.approx(visit.received(WorldMotion)[0].xr_from_world.position, abs=1e-6)
    assert [each.way_m for each in visit.observed if isinstance(each, events.SeatFollowed)] == [
        pytest.approx(0.3, abs=0.05)
    ]
    found = verify_recording(recording)
    assert found.num_identical_states == found.num_states > 0
