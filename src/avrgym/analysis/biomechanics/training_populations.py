"""Sample people from the training populations of the policies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import numpy as np

from avrgym.analysis.column_types import AT_LEAST_0_TEXT, IsSimulated, TaskName
from avrgym.analysis.reading.table_rows import TrialRow
from avrgym.analysis.reading.trial_time_series import WAIST_JOINT_INDICES, compute_head_centres
from avrgym.array_types import FloatArray
from avrgym.models.human import SEXES
from avrgym.people.arm_clearance import make_furniture_boxes
from avrgym.people.distributions import (
    NUM_RANDOM_NUMBERS,
    POPULATION_DISTRIBUTIONS,
    PeopleDistribution,
    sample_people,
)
from avrgym.robots.registry import ROBOTS
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.system import random_streams
from avrgym.system.columns import Column
from avrgym.tasks.registry import ENVIRONMENTS, TASKS

PostureName = Annotated[str, Column("Posture.", allowed="seated, in bed")]
WaistAngle = Annotated[float, Column("Waist angle about this axis.", unit="°")]
HeadCoordinate = Annotated[float, Column("Head centre on this axis of the world frame.", unit="m")]


@dataclass(frozen=True, kw_only=True)
class SampledPersonRow:
    """Body, waist angles and head position of a person sampled from a training population."""

    simulated: IsSimulated
    population: Annotated[str, Column("The training population.")]
    task: TaskName
    posture: PostureName
    number: Annotated[
        int, Column("Number of the person within task and population.", allowed=AT_LEAST_0_TEXT)
    ]
    sex: Annotated[str, COLUMNS_BY_TABLE["participants"]["sex"]]
    torso_height_m: Annotated[float, Column("Torso height, from hip bone to centre of the head.", unit="m")]
    waist_x_deg: WaistAngle
    waist_y_deg: WaistAngle
    waist_z_deg: WaistAngle
    head_x_m: HeadCoordinate
    head_y_m: HeadCoordinate
    head_z_m: HeadCoordinate


SAMPLED_PEOPLE_PER_TASK = 500
AXIS_NAMES = ("x", "y", "z")
_ORIGINAL, _REVISED = POPULATION_DISTRIBUTIONS["original"], POPULATION_DISTRIBUTIONS["revised"]
TRAINING_POPULATIONS: Mapping[str, PeopleDistribution] = {
    "original": _ORIGINAL,
    "original, heights varied": replace(_REVISED, max_waist_angle_deg=_ORIGINAL.max_waist_angle_deg),
    "revised": _REVISED,
}
"""Training populations by name.

The second population has the heights of Revised and the waist angles of Original. As in the paper, it separates the
effect of heights from the effect of waist angles.
"""
HEIGHT_POPULATION_NAMES = ("original", "revised")
"""Names of the populations with different distributions of torso height."""


def find_task_posture(task: str) -> str:
    """Returns the posture of the person in a task: ``seated`` or ``in bed``."""
    robot = next(robot for each, robot in ENVIRONMENTS.values() if each == task)
    seated = TASKS[task].make_scene(ROBOTS[robot]).posture.is_seated
    return "seated" if seated else "in bed"


def sample_training_populations(design: Design) -> list[SampledPersonRow]:
    """Returns ``SAMPLED_PEOPLE_PER_TASK`` sampled people for each population and task.

    The distributions are the same as in training.
    """
    return [
        row
        for name, task in product(TRAINING_POPULATIONS, design.tasks)
        for row in _people(name, task, design.robots[0])
    ]


def _people(name: str, task: str, robot: str) -> list[SampledPersonRow]:
    """Returns sampled people of one population for one task. The random seed depends only on population and task."""
    scene = TASKS[task].make_scene(ROBOTS[robot])
    rng = random_streams.make_training_population_rng(
        list(TRAINING_POPULATIONS).index(name), list(TASKS).index(task)
    )
    uniforms = rng.random((SAMPLED_PEOPLE_PER_TASK, NUM_RANDOM_NUMBERS))
    drawn = sample_people(
        TRAINING_POPULATIONS[name],
        TASKS[task].pose_distribution,
        scene.posture,
        make_furniture_boxes(scene.furniture),
        uniforms,
    )
    heads_w = compute_head_centres(drawn, scene.posture)
    waists_deg = np.degrees(drawn.joint_angles_rad[:, WAIST_JOINT_INDICES])
    return [
        SampledPersonRow(
            simulated=True,
            population=name,
            task=task,
            posture=find_task_posture(task),
            number=number,
            sex=SEXES[int(drawn.is_woman[number])],
            torso_height_m=float(drawn.torso_height_m[number]),
            **{
                f"waist_{axis}_deg": float(waist)
                for axis, waist in zip(AXIS_NAMES, waists_deg[number], strict=True)
            },
            **{f"head_{axis}_m": float(head) for axis, head in zip(AXIS_NAMES, heads_w[number], strict=True)},
        )
        for number in range(SAMPLED_PEOPLE_PER_TASK)
    ]


def collect_training_head_positions(
    people: Sequence[SampledPersonRow], name: str, posture: str
) -> FloatArray:
    """Returns the head positions (n, 3) of sampled people from one population, in metres in the world frame.

    ``name``: name of the population. ``posture``: only people in this posture are included.
    """
    return np.array(
        [read_head_position(row) for row in people if (row.population, row.posture) == (name, posture)]
    )


def read_head_position(row: TrialRow | SampledPersonRow) -> tuple[float, ...]:
    """Returns the head centre (x, y, z) in a table row, in metres in the world frame."""
    return tuple(float(getattr(row, f"head_{axis}_m")) for axis in AXIS_NAMES)
