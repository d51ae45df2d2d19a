"""Commands to the robot in each trial: number, waiting time, and agreement with the robot's motion."""

from dataclasses import dataclass
from typing import Annotated, get_args

from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    FRACTION_RANGE_TEXT,
    PolicyName,
    RobotName,
    TaskName,
    TrialPosition,
)
from avrgym.analysis.reading.table_rows import ParticipantColumns, TrialRow
from avrgym.commands.preferences import BiteTiming, PreferredSide
from avrgym.commands.vocabulary import COMMAND_NAMES
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Pacing, RobotCommand
from avrgym.system.columns import Column

AGREEMENT_WINDOW_STEPS = 15
"""The robot's reaction to a command is measured over this number of control steps."""
MIN_DISTANCE_CHANGE_M = 0.01
"""Minimum change in metres of the distance between tool and target. A smaller change is ignored."""
NEAR_TARGET_DISTANCE_M = 0.05
"""Distance in metres below which the tool is considered near the target."""
_AVERAGE = "no command was given"


@dataclass(frozen=True, kw_only=True)
class TrialCommandsRow(ParticipantColumns):
    """Commands to the robot in one completed trial.

    Trials without commands and without the participant's preferences have no row.
    """

    position: TrialPosition
    task: TaskName
    robot: RobotName
    policy: PolicyName
    counted: Annotated[bool, Column("Whether it is in the analyses.")]
    commands: Annotated[int, Column("Number of executed commands.", allowed=AT_LEAST_0_TEXT)]
    ignored: Annotated[int, Column("Number of ignored commands.", allowed=AT_LEAST_0_TEXT)]
    names: Annotated[
        str,
        Column("Number of executed commands by name.", allowed=f"NAME=NUMBER of {', '.join(COMMAND_NAMES)}"),
    ]
    sources: Annotated[str, Column("Number of executed commands by source.", allowed="SOURCE=NUMBER")]
    waiting_s: Annotated[
        float,
        Column("Time for which the robot waited at its waiting pose.", unit="s", allowed=AT_LEAST_0_TEXT),
    ]
    agreement_share: Annotated[
        float | None,
        Column(
            "Share of the executed commands after which the robot did what they mean, within 1.5 s.",
            allowed=FRACTION_RANGE_TEXT,
            empty=_AVERAGE,
        ),
    ]
    speed_factor: Annotated[float, Column("Factor of the policy's speed, mean over the trial.")]
    distance_m: Annotated[float, Column("Preferred distance of the tool at the end of the trial.", unit="m")]
    preferred_speed: Annotated[
        float, Column("Preferred factor of the policy's speed, at the start of the trial.")
    ]
    preferred_distance_m: Annotated[
        float, Column("Preferred distance of the tool, at the start of the trial.", unit="m")
    ]
    preferred_side: Annotated[
        str, Column("Preferred side of the waiting tool.", allowed=", ".join(get_args(PreferredSide)))
    ]
    bite_timing: Annotated[
        str,
        Column("Condition for leaving the waiting pose.", allowed=", ".join(get_args(BiteTiming))),
    ]
    pause_s: Annotated[
        float, Column("Pause after which the robot continues by itself, if it does.", unit="s")
    ]
    force_share: Annotated[
        float,
        Column(
            "Share of the force limits at which the force guard retracts the arm.",
            allowed=FRACTION_RANGE_TEXT,
        ),
    ]


def make_trial_commands_row(
    recording: Recording, row: TrialRow, control_step_s: float
) -> TrialCommandsRow | None:
    """Returns the row of a trial; ``None`` if the trial had no commands and no preferences."""
    pacing: list[Pacing] = [record for _, record in recording.messages_by_topic["/pacing"]]
    rules = recording.configuration.trial_rules
    if rules is None or not pacing:
        return None
    given: list[RobotCommand] = [record for _, record in recording.messages_by_topic["/robot_commands"]]
    executed = [command for command in given if not command.refusal_reason]
    agreed = [_agrees(command, pacing) for command in executed]
    waiting = sum(record.mode == "waiting" for record in pacing)
    return TrialCommandsRow(
        participant=row.participant,
        site=row.site,
        simulated=row.simulated,
        position=row.position,
        task=row.task,
        robot=row.robot,
        policy=row.policy,
        counted=row.counted,
        commands=len(executed),
        ignored=len(given) - len(executed),
        names=_counts([command.name for command in executed]),
        sources=_counts([command.source for command in executed]),
        waiting_s=waiting * control_step_s,
        agreement_share=sum(agreed) / len(agreed) if agreed else None,
        speed_factor=sum(record.speed_factor for record in pacing) / len(pacing),
        distance_m=pacing[-1].preferred_distance_m,
        preferred_speed=rules.preferences.speed,
        preferred_distance_m=rules.preferences.distance_m,
        preferred_side=rules.preferences.side,
        bite_timing=rules.preferences.bite_timing,
        pause_s=rules.preferences.pause_s,
        force_share=rules.preferences.force_share,
    )


def _counts(names: list[str]) -> str:
    return " ".join(f"{name}={names.count(name)}" for name in sorted(set(names)))


def _agrees(command: RobotCommand, pacing: list[Pacing]) -> bool:
    """Returns whether the robot's motion agrees with a command.

    After an approach command, the tool approaches the target, or is near it. After a waiting command, the tool does not
    approach. After a speed command, the speed factor changes, or is at its limit.
    """
    after = pacing[command.step : command.step + AGREEMENT_WINDOW_STEPS]
    if not after:
        return command.name == "stop"
    before = pacing[max(command.step - 1, 0)]
    nearest_m, last_m = min(record.tool_distance_m for record in after), after[-1].tool_distance_m
    match command.name:
        case "ready" | "again" | "closer":
            return (
                nearest_m < before.tool_distance_m - MIN_DISTANCE_CHANGE_M
                or nearest_m < NEAR_TARGET_DISTANCE_M
            )
        case "slower":
            return after[0].speed_factor < before.speed_factor or not command.had_effect
        case "faster":
            return after[0].speed_factor > before.speed_factor or not command.had_effect
        case _:
            return last_m > before.tool_distance_m - MIN_DISTANCE_CHANGE_M
