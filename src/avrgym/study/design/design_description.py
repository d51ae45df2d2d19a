"""Describe a design in sentences, for publications and registries."""

from avrgym.study.design.allocation import make_trial_orders
from avrgym.study.design.design import Design


def describe_procedure(design: Design) -> str:
    """Returns sentences about tasks, instructions, duration of trials, and scene settings."""
    goals = " ".join(design.find_task_instruction(task) for task in design.tasks)
    return (
        "In virtual reality simulated robots help participants with everyday tasks. Instructions to participants: "
        f"{goals} Each trial lasts {design.trial_steps / design.settings.control_hz:g} s.{_settings(design)}"
    )


def _settings(design: Design) -> str:
    return f" Settings of the scenes: {design.settings}." if design.settings.changed_values else ""


def describe_blinding(design: Design) -> str:
    """Returns sentences about who knows the policy of a trial: participants, experimenter."""
    experimenter = (
        "The experimenter does not know the policy either, and sees a letter for each policy."
        if design.blind_experimenter
        else "The experimenter knows the policy."
    )
    return f"Participants do not know the policy of a trial. {experimenter}"


def describe_conditions(design: Design) -> str:
    """Returns sentences about the numbers and names of conditions, and about practice trials."""
    practice = f" Before each task: one practice trial with the policy {design.practice_policy}."
    return (
        f"Within participants: {len(design.tasks)} × {len(design.robots)} × {len(design.policies)} conditions "
        f"(tasks {', '.join(design.tasks)}; robots {', '.join(design.robots)}; policies {', '.join(design.policies)}), "
        f"one trial of each.{practice if design.practice_policy else ''}"
    )


def describe_randomization(design: Design) -> str:
    """Returns sentences about Williams squares, the number of orders, and the allocation of participants."""
    return (
        "Tasks, and conditions within each task, follow Williams squares, randomised by the design's seed: "
        f"{len(make_trial_orders(design))} orders. Each participant is allocated to the least filled order."
    )
