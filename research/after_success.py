"""Contact after success in sessions of a simulated participant, with and without withdrawal.

    python research/after_success.py    prints the table of the note of 2026-11-27; takes half an hour on one core

Each row is a session of eight trials of 20 s, seeds 0 to 7, with the force guard.
"""

import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple

from avrgym.recording.reader import Recording, read_recording
from avrgym.recording.schema import Control
from avrgym.safety.force_guard import INTERVENTION_EVENT
from avrgym.vr.emulation.in_process_client import InProcessClient
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session

ENVIRONMENTS = "FeedingJaco", "DrinkingPR2"
POLICIES = "revised", "adaptive"
TRIALS = 8


class Trial(NamedTuple):
    """Of one trial: interventions of the guard before and after success; the forces of the steps after it, N."""

    interventions_before: int
    interventions_after: int
    forces_after_n: list[float]


def main() -> None:
    """Print the table."""
    print("| environment | policy | withdraws | interventions before | after success | contact | peak |")
    print("|---|---|---|---|---|---|---|")
    for environment, policy, withdraws in product(ENVIRONMENTS, POLICIES, (False, True)):
        trials = list(session(environment, policy, withdraws=withdraws))
        forces_n = [force_n for trial in trials for force_n in trial.forces_after_n]
        touching = sum(force_n > 0.0 for force_n in forces_n) / len(forces_n)
        before = sum(trial.interventions_before for trial in trials)
        after = sum(trial.interventions_after for trial in trials)
        how = "yes" if withdraws else "no"
        figures = f"{before} | {after} | {100.0 * touching:.0f} % | {max(forces_n):.0f} N"
        print(f"| {environment} | {policy} | {how} | {figures} |", flush=True)


def session(environment: str, policy: str, *, withdraws: bool) -> Iterator[Trial]:
    """Run a session, and read what was recorded."""
    name = f"avrgym/{environment}-v1"
    plan = SessionPlan(
        [TrialPlan(name, policy, seed, practice=False) for seed in range(TRIALS)],
        "woman",
        free_movement_s=1.0,
        is_simulated=True,
        questionnaire_items=(),
        countdown_s=2.0,
        withdraw_tool_after_success=withdraws,
    )
    with tempfile.TemporaryDirectory() as folder:
        client = InProcessClient(
            SimulatedParticipant(sample_participant_traits(plan.sex, 0), 0), lambda _: None
        )
        running = Session(plan, load_policies(plan), Path(folder), client.receive, identifier="after-success")
        client.run(running)
        yield from (trial(read_recording(path)) for path in running.recordings)


def trial(recording: Recording) -> Trial:
    """What a recording holds; without success all of it is before."""
    steps: list[tuple[int, Control]] = recording.messages_by_topic["/control"]
    success_ns = next((time_ns for time_ns, step in steps if step.success), None)
    acts_ns = [
        time_ns
        for time_ns, event in recording.messages_by_topic["/events"]
        if event.name == INTERVENTION_EVENT
    ]
    if success_ns is None:
        return Trial(len(acts_ns), 0, [])
    after = [step.force_on_person_n for time_ns, step in steps if time_ns > success_ns]
    acted_after = sum(time_ns > success_ns for time_ns in acts_ns)
    return Trial(len(acts_ns) - acted_after, acted_after, after)


if __name__ == "__main__":
    main()
