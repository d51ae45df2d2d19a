"""Body measures from recordings agree with MuJoCo's kinematics; targets hold until they change."""

import dataclasses
from datetime import UTC, datetime
from math import fsum

import msgspec
import mujoco
import numpy as np
import pytest

from avrgym.analysis.reading import study_data
from avrgym.analysis.reading.trial_time_series import compute_head_centres, read_trial_time_series
from avrgym.models import human
from avrgym.models.human import (
    JOINTS,
    LOWER_LIMITS_RAD,
    RECLINED_POSTURE,
    SEATED_POSTURE,
    UPPER_LIMITS_RAD,
    People,
    Person,
    Posture,
)
from avrgym.recording.configuration import BodyModel, TrialConfiguration
from avrgym.recording.reader import Recording
from avrgym.recording.schema import BodyTargets, Control
from helpers.studies.configurations import configuration

KNOWN_BODY = configuration(person=BodyModel("woman", 0.55, "fair"), joint_names=tuple(JOINTS))


@pytest.mark.parametrize("posture", [SEATED_POSTURE, RECLINED_POSTURE], ids=["seated", "in bed"])
def test_heads_are_where_mujoco_puts_them(posture: Posture, rng: np.random.Generator) -> None:
    for sex in human.SEXES:
        person = Person(sex, rng.uniform(0.5, 0.6), rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD))
        model = human.compile_person_model(person, posture, moving=True)
        data = mujoco.MjData(model)
        data.qpos[:] = person.joint_angles_rad
        mujoco.mj_kinematics(model, data)
        expected = data.site(human.PERSON_NAME_PREFIX + "head_centre").xpos
        assert compute_head_centres(People.from_persons([person]), posture)[0] == pytest.approx(
            expected, abs=1e-12
        )


def _recorded(targets: list[tuple[int, float]], recorded: TrialConfiguration) -> Recording:
    """Waist angles x in degrees at times in milliseconds; control steps at 100, 200 and 300 ms."""
    messages = [
        (
            "/body_targets",
            time_ms * 1_000_000,
            BodyTargets(human.make_seated_joint_angles(waist_x=angle).tolist()),
        )
        for time_ms, angle in targets
    ]
    steps = [
        ("/control", step * 100_000_000, Control(step, [], [], 1.0, {}, False, 0.1, 2.0))
        for step in (1, 2, 3)
    ]
    return Recording(recorded, None, [*messages, *steps], True, datetime.now(UTC))


def test_targets_hold_until_they_change() -> None:
    body = read_trial_time_series(
        _recorded([(150, 5.0), (199, 10.0), (400, 20.0)], KNOWN_BODY), SEATED_POSTURE
    ).posture_series
    assert body is not None
    assert np.degrees(body.waist_angles_rad[:, 0]) == pytest.approx([5.0, 10.0, 10.0])
    assert body.torso_height_m == 0.55
    assert body.head_centre_pos_w.shape == (3, 3)


@pytest.mark.parametrize(
    ("targets", "recorded"),
    [
        ([], KNOWN_BODY),
        ([(0, 1.0)], msgspec.structs.replace(KNOWN_BODY, joint_names=("waist_x",))),
    ],
)
def test_without_targets_or_a_known_body_there_is_none(targets: list, recorded: TrialConfiguration) -> None:
    measured = read_trial_time_series(_recorded(targets, recorded), SEATED_POSTURE)
    assert measured.posture_series is None
    assert measured.times_s == [0.1, 0.2, 0.3]


def test_rewards_are_added_up_one_by_one_whatever_sum_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Since Python 3.12 ``sum`` makes up for rounding, and a session's total does not."""
    monkeypatch.setattr(study_data, "sum", fsum, raising=False)
    measured = read_trial_time_series(_recorded([], KNOWN_BODY), SEATED_POSTURE)
    steps = [msgspec.structs.replace(measured.control_steps[0], reward=0.1) for _ in range(10)]
    total = 0.0
    for step in steps:
        total += step.reward
    assert total != fsum(step.reward for step in steps)
    assert (
        study_data._step_metrics(dataclasses.replace(measured, control_steps=steps))["reward_recorded"]
        == total
    )
