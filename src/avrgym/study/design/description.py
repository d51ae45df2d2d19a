"""A design in words, as publications and registries say it."""

from avrgym.study.design.allocation import cell_orders
from avrgym.study.design.design import Design
from avrgym.tasks.registry import TASKS


def describe_procedure(design: Design) -> str:
    """What happens in a trial."""
    told = " ".join(design.goals.get(task) or TASKS[task].goal for task in design.tasks)
    return (
        f"In virtual reality simulated robots help participants with everyday tasks. They are told: {told} "
        f"Each trial lasts {design.trial_steps / 10:g} s."
    )


def describe_blinding(design: Design) -> str:
    """Who knows which policy is met."""
    led = (
        "Neither does the experimenter, who sees a letter for each policy."
        if design.blind_experimenter
        else "The experimenter knows."
    )
    return f"Participants do not know which policy they meet. {led}"


def describe_conditions(design: Design) -> str:
    """What is compared, within whom."""
    practice = f" Before each task: one practice trial with the policy {design.practice_policy}."
    return (
        f"Within participants: {len(design.tasks)} × {len(design.robots)} × {len(design.policies)} conditions "
        f"(tasks {', '.join(design.tasks)}; robots {', '.join(design.robots)}; policies {', '.join(design.policies)}), "
        f"one trial of each.{practice if design.practice_policy else ''}"
    )


def describe_randomization(design: Design) -> str:
    """How orders come about."""
    return (
        "Tasks, and conditions within each task, follow Williams squares, randomised by the design's seed: "
        f"{len(cell_orders(design))} orders, of which each participant gets the one that fewest have."
    )
