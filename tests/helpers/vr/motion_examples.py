"""Movements of simulated participants for the client's tests: python motion_examples.py.

Contains one session of each environment: rest, free movement, trial and retreat.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from avrgym.tasks.constants import PAPER_ENVIRONMENTS
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.vr.visit import FRAME_EVERY_TICKS, Visit

FILE = Path(__file__).parents[3] / "client/tests/data/motions.json"
FRAME_STEP = 5
"""Every fifth frame is written: five per second."""


class RecordingVisit(Visit):
    """A visit that stores the participant's frames."""

    def __init__(self, folder: Path, environment: str, seed: int, trial_steps: int) -> None:
        """Plan a session of one trial."""
        trial = TrialPlan(environment, "revised", seed, practice=False)
        plan = SessionPlan(
            [trial], "woman" if seed % 2 else "man", 3.0, is_simulated=True, trial_steps=trial_steps
        )
        person = SimulatedParticipant(sample_participant_traits(plan.sex, seed), seed)
        self.frames: list[TrackingFrameMessage] = []
        super().__init__(folder, plan, load_policies(plan), person)

    def frame(self) -> TrackingFrameMessage:
        """Return and store the participant's next frame."""
        frame = super().frame()
        self.frames.append(frame)
        return frame


def examples(trial_steps: int, seeds: int) -> Iterator[dict[str, object]]:
    """Yield a session for each seed and environment: the frame interval in ms and the frames."""
    for seed in range(seeds):
        for number, environment in enumerate(PAPER_ENVIRONMENTS):
            with TemporaryDirectory() as folder:
                visit = RecordingVisit(Path(folder), environment, 100 * seed + number, trial_steps)
                visit.participant.adopt_posture(environment)
                visit.calibrate()
                visit.run_until("questionnaire", limit_s=120.0)
                visit.leave()
            rows = [_row(frame) for frame in visit.frames[::FRAME_STEP]]
            yield {"environment": environment, "everyMs": 10 * FRAME_EVERY_TICKS * FRAME_STEP, "frames": rows}


def _row(frame: TrackingFrameMessage) -> list[int]:
    """Return head, left and right: positions in mm, quaternions in thousandths."""
    return [number for pose in (frame.head, frame.left, frame.right) for number in _plain(pose)]


def _plain(pose: XRPose | None) -> list[int]:
    assert pose is not None
    return [round(1000 * value) for value in (*pose.position, *pose.orientation)]


if __name__ == "__main__":
    trial_steps, seeds, path = (
        (*map(int, sys.argv[1:3]), Path(sys.argv[3])) if len(sys.argv) > 3 else (150, 1, FILE)
    )
    path.write_text(json.dumps(list(examples(trial_steps, seeds)), separators=(",", ":")) + "\n")
