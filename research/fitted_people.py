"""Checks of behaviour that is fitted to recordings. Simulated participants have known parameters.

    python research/fitted_people.py simulate FOLDER [N]  N participants (40) with drawn parameters take part in a study
    python research/fitted_people.py recover FOLDER       fits and compares parameters; writes FOLDER/fitted.toml
    python research/fitted_people.py distinguish FOLDER   a classifier separates recorded and refitted motion
    python research/fitted_people.py use FOLDER           evaluates policies with fitted and with held-out people

`simulate` and `use` continue where they were interrupted. Results are in `research/fitted_people.json`.
"""

import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from scipy import optimize, stats

import figures_file
from avrgym.analysis.fit_behaviour import fit_behaviour
from avrgym.analysis.fit_people import fit_people, write_people_file
from avrgym.analysis.recorded_motion import MOTION_JOINT_NAMES, RecordedMotion, read_recorded_motion
from avrgym.learning.evaluation import evaluate
from avrgym.models.human import JOINT_INDEX, People
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.people import motor_model
from avrgym.people.people_file import MeanAndStandardDeviation
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partners import (
    DEFAULT_PARAMETER_BOUNDS,
    PARAMETER_BOUNDS,
    apply_partner_bodies,
    make_behaviour_parameters,
)
from avrgym.study.export.exported_attempts import list_completed_attempts
from avrgym.study.sessions.dry_run import make_dry_run_settings, sample_dry_run_traits
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import write_atomically

FILE = Path(__file__).with_suffix(".json")
SEED = 5
DESIGN = {
    "tasks": '["Feeding"]',
    "robots": '["Jaco"]',
    "practice_policy": '""',
    "headset_check": "false",
    "free_movement_s": "1.0",
    "trial_steps": "150",
}
"""Two trials of 15 s for each participant, with the policies original and revised."""
GROUP = {
    "reaction_s": (0.35, 0.08),
    "facing_share": (0.5, 0.12),
    "approach_share": (0.8, 0.2),
    "speed_share": (0.85, 0.15),
    "startle_deg": (10.0, 3.0),
    "startle_distance_m": (0.2, 0.03),
    "startle_duration_s": (1.0, 0.2),
    "sway_deg": (0.7, 0.2),
    "sway_hz": (0.22, 0.05),
    "tremor_deg": (0.5, 0.2),
    "tremor_hz": (6.0, 1.0),
}
"""Means and standard deviations of the group of which the hidden parameters are drawn."""
WINDOW_S, FRAME_HZ, COVERAGE = 2.0, 50, 0.9
SMOOTHED_FRAMES = 25
BANDS_HZ = ((0.4, 1.0), (1.0, 3.0), (3.0, 8.0), (8.0, 12.0))
FOLDS, PENALTY = 8, 1.0


def new_study(folder: Path, count: int) -> None:
    """Create the study, and the people file of the group, if they are missing."""
    if not (folder / "study.toml").exists():
        subprocess.run(["avrgym", "study", "new", str(folder)], check=True)
        changed, lines = DESIGN | {"participants": str(count)}, []
        for line in (folder / "study.toml").read_text().splitlines():
            key = line.partition(" = ")[0]
            lines.append(f"{key} = {changed[key]}" if key in changed else line)
        (folder / "study.toml").write_text("\n".join(lines) + "\n")
    values = "".join(f"{name} = [{mean}, {deviation}]\n" for name, (mean, deviation) in GROUP.items())
    heights = "[torso_height_m]\nman = [0.51, 0.58]\nwoman = [0.51, 0.58]\n"
    if not (folder / "group.toml").exists():
        write_atomically(
            folder / "group.toml", f"cooperating = true\n{heights}[[behaviour]]\n{values}".encode()
        )


def simulate(folder: Path, people: Path, count: int, seed: int) -> None:
    """Let simulated participants complete a study through the server's session."""
    new_study(folder, count)
    arguments = ["--participants", str(count), "--seed", str(seed), "--people", str(people)]
    subprocess.run(["avrgym", "study", "simulate", str(folder), *arguments], check=True)


def motions_of(folder: Path) -> list[RecordedMotion]:
    """Motions in all completed trials."""
    with StudyStore(folder) as store:
        return [
            read_recorded_motion(each.participant.pseudonym, each.read_complete_recording())
            for each in list_completed_attempts(store)
        ]


def recover(folder: Path) -> Iterator[str]:
    """Fit the participants, compare with their parameters, and write the fitted people."""
    fit = fit_people(folder)
    assert fit.behaviour is not None
    if not (folder / "fitted.toml").exists():
        write_people_file(fit, folder / "fitted.toml")
    run = make_dry_run_settings(SEED, str(folder / "group.toml"), "none")
    with StudyStore(folder) as store:
        true = [
            sample_dry_run_traits(store.read_participant(name), run).behaviour_parameters
            for name in fit.behaviour.participants
        ]
    within = stats.norm.ppf(0.5 + 0.5 * COVERAGE)
    rows: dict[str, object] = {}
    yield "| parameter | true | fitted | RMSE | posterior SD | r | coverage |\n|---|---|---|---|---|---|---|"
    covered: list[np.ndarray] = []
    for name, found in fit.behaviour.estimates_by_parameter.items():
        values = np.array([float(getattr(each, name)[0]) for each in true])
        error = found.posterior_mean - values
        covered.append(np.abs(error) < within * found.posterior_sd)
        rows[name] = figures = {
            "true": [float(values.mean()), float(values.std())],
            "fitted": [found.group_mean, found.group_sd],
            "rmse": float(np.sqrt(np.mean(error**2))),
            "posterior_sd": float(np.sqrt(np.mean(found.posterior_sd**2))),
            "correlation": float(np.corrcoef(values, found.posterior_mean)[0, 1])
            if np.ptp(found.posterior_mean) > 1e-9
            else 0.0,
            "coverage": float(covered[-1].mean()),
        }
        (mean, sd), (group_mean, group_sd) = figures["true"], figures["fitted"]
        yield (
            f"| {name} | {mean:.3g} ± {sd:.2g} | {group_mean:.3g} ± {group_sd:.2g} | {figures['rmse']:.3g} | "
            f"{figures['posterior_sd']:.3g} | {figures['correlation']:.2f} | {figures['coverage']:.2f} |"
        )
    store_figures(
        "recover", {"participants": len(true), "coverage": float(np.mean(covered)), "parameters": rows}
    )
    yield f"{len(true)} participants; coverage over all parameters {np.mean(covered):.3f}"


def store_figures(name: str, figures: object) -> None:
    write_atomically(
        FILE, msgspec.json.format(msgspec.json.encode(figures_file.read(FILE) | {name: figures}))
    )


# Indistinguishability ----------------------------------------------------------------------------------------


def features(motion: RecordedMotion, *, slow_waist: bool) -> tuple[np.ndarray, list[str]]:
    """Features (W, F) of windows of 2 s while the robot acts, and their names.

    For each angle of waist and head: mean, logarithms of standard deviation, largest speed and acceleration, and of the
    power in four bands. Also the mean distance of the tool from the head. ``slow_waist``: the waist's motion above 2 Hz
    is removed. Inverse kinematics with a measured torso height adds some, which refitted motion lacks.
    """
    size = round(WINDOW_S * FRAME_HZ)
    angles = np.degrees(
        motion.joint_angles_rad[DEFAULT_SUBSTEPS * motion.first_robot_motion_sample + 1 :: 2, :4]
    )
    if slow_waist:
        smooth = np.hanning(SMOOTHED_FRAMES + 2)[1:-1]
        for channel in (0, 1):
            ends = np.pad(angles[:, channel], SMOOTHED_FRAMES // 2, mode="edge")
            angles[:, channel] = np.convolve(ends, smooth / smooth.sum(), mode="valid")[: len(angles)]
    gap_m = np.repeat(
        np.linalg.norm(motion.tool_pos_w - motion.head_pos_w, axis=1)[motion.first_robot_motion_sample :],
        DEFAULT_SUBSTEPS // 2,
    )
    speed = np.gradient(angles, 1.0 / FRAME_HZ, axis=0)
    acceleration = np.gradient(speed, 1.0 / FRAME_HZ, axis=0)
    hertz, rows = np.fft.rfftfreq(size, 1.0 / FRAME_HZ), []
    for first in range(0, len(angles) - size + 1, size):
        window = slice(first, first + size)
        row = {"tool distance": gap_m[window].mean()}
        for channel, name in enumerate(MOTION_JOINT_NAMES[:4]):
            own = angles[window, channel]
            power = np.abs(np.fft.rfft((own - own.mean()) * np.hanning(size))) ** 2
            row[f"{name} mean"] = own.mean()
            row[f"{name} SD"] = np.log(own.std() + 1e-2)
            row[f"{name} speed"] = np.log(np.abs(speed[window, channel]).max() + 1e-1)
            row[f"{name} acceleration"] = np.log(np.abs(acceleration[window, channel]).max() + 1.0)
            for low, high in BANDS_HZ:
                if not (slow_waist and channel < 2 and low >= 1.0):
                    inside = (hertz >= low) & (hertz < high)
                    row[f"{name} {low:g}-{high:g} Hz"] = np.log(power[inside].sum() + 1e-2)
        rows.append(row)
    return np.array([list(row.values()) for row in rows]), list(rows[0])


@dataclass(frozen=True)
class Perceived:
    """What people perceive in one step of their recordings."""

    tool_pos_w: np.ndarray
    head_pos_w: np.ndarray
    mouth_pos_w: np.ndarray
    right_arm_pos_w: np.ndarray


def refitted(
    motions: Sequence[RecordedMotion], estimates: Mapping[str, Mapping[str, MeanAndStandardDeviation]]
) -> list[RecordedMotion]:
    """Motion of people with fitted parameters, who perceive the recorded tool: with noise, sway and tremor.

    The parameters are samples of each participant's posterior distribution. Poses are sent 50 times a second.
    """
    rng = np.random.default_rng(SEED)
    sampled = {
        name: {
            key: float(np.clip(rng.normal(*estimate), *PARAMETER_BOUNDS.get(key, DEFAULT_PARAMETER_BOUNDS)))
            for key, estimate in own.items()
        }
        for name, own in estimates.items()
    }
    parameters = make_behaviour_parameters([sampled[each.participant] for each in motions])
    people = apply_partner_bodies(People.from_persons([each.person for each in motions]), parameters)
    state = partner_behaviour.make_initial_state(people, parameters, rng.random((len(motions), 4)))
    moved, shown = partner_behaviour.make_initial_motor_state(state, people), []
    for step in range(max(len(each.tool_pos_w) for each in motions)):
        now = Perceived(
            *(
                np.stack([getattr(each, name)[min(step, len(each.tool_pos_w) - 1)] for each in motions])
                for name in ("tool_w", "head_w", "mouth_w", "right_arm_w")
            )
        )
        state, goals = partner_behaviour.choose_goal_angles(
            replace(state, joint_targets_rad=moved.second_filter_angles_rad),
            now,
            motions[0].offered_body_part,
            motions[0].posture,
        )
        moved = motor_model.set_goal_angles(moved, goals, partner_behaviour.are_startled(state))
        moved, targets = motor_model.advance_joint_targets_rad(moved, DEFAULT_SUBSTEPS)
        shown.append(targets[..., [JOINT_INDEX[name] for name in MOTION_JOINT_NAMES]])
    angles = np.repeat(np.concatenate(shown)[1::2], 2, axis=0)
    return [
        replace(each, joint_angles_rad=angles[: len(each.joint_angles_rad), number])
        for number, each in enumerate(motions)
    ]


def distinguish(folder: Path) -> Iterator[str]:
    """Cross-validated AUC of logistic regression on features and their squares."""
    motions = motions_of(folder)
    fit = fit_behaviour(motions)
    own = dict(zip(fit.participants, fit.list_participant_estimates(), strict=True))
    sets = [motions, refitted(motions, own)]
    for slow_waist in (False, True):
        found = [[features(each, slow_waist=slow_waist) for each in of_set] for of_set in sets]
        names = found[0][0][1]
        x = np.concatenate([values for of_set in found for values, _ in of_set])
        y = np.repeat([0, 1], len(x) // 2)
        groups = [each.participant for each in motions for _ in features(each, slow_waist=slow_waist)[0]] * 2
        fold = np.array([fit.participants.index(group) % FOLDS for group in groups])
        scores = np.zeros(len(y))
        for number in np.unique(fold):
            train, test = fold != number, fold == number
            scores[test] = classified(x[train], y[train], x[test])
        alone = {name: abs(auc(x[:, column], y) - 0.5) + 0.5 for column, name in enumerate(names)}
        best = dict(sorted(alone.items(), key=lambda item: -item[1])[:8])
        waist = "without fast motion of the waist" if slow_waist else "all motion"
        yield f"{waist}: {len(own)} participants, {len(y)} windows, AUC {auc(scores, y):.3f}"
        yield "; ".join(f"{name} {value:.2f}" for name, value in best.items())
        figures = {
            "participants": len(own),
            "windows": len(y),
            "auc": auc(scores, y),
            "single_features": best,
        }
        store_figures(f"distinguish, {waist}", figures)


def classified(x: np.ndarray, y: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """Scores of unknown rows by logistic regression with a quadratic penalty."""
    mean, deviation = x.mean(axis=0), x.std(axis=0) + 1e-9

    def expanded(values: np.ndarray) -> np.ndarray:
        scaled = np.clip((values - mean) / deviation, -5.0, 5.0)
        return np.concatenate([np.ones((len(values), 1)), scaled, scaled**2 - 1.0], axis=1)

    inputs, sign = expanded(x), 2.0 * y - 1.0

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        margin = sign * (inputs @ weights)
        slope = -sign / (1.0 + np.exp(np.clip(margin, -500.0, 500.0)))
        penalty = PENALTY * weights * (np.arange(len(weights)) > 0)
        return float(np.logaddexp(0.0, -margin).sum() + 0.5 * penalty @ weights), inputs.T @ slope + penalty

    found = optimize.minimize(loss, np.zeros(inputs.shape[1]), jac=True, method="L-BFGS-B")
    return expanded(unknown) @ found.x


def auc(scores: np.ndarray, labels: np.ndarray) -> float:
    """Area under the ROC curve: the probability that a refitted window has a higher score than a recorded one."""
    ranks = stats.rankdata(scores)
    positive = labels == 1
    wins = ranks[positive].sum() - 0.5 * positive.sum() * (positive.sum() + 1)
    return float(wins / (positive.sum() * (~positive).sum()))


# Use ---------------------------------------------------------------------------------------------------------


def use(folder: Path, episodes: int = 60) -> Iterator[str]:
    """Evaluate packaged policies with fitted people, and with further people of the group."""
    yield "| policy | people | success | mean force N | episodes over a limit |\n|---|---|---|---|---|"
    for policy in ("revised", "adaptive"):
        for people in ("fitted.toml", "group.toml"):
            name = f"use {policy} {people}"
            if name not in figures_file.read(FILE):
                row = evaluate("avrgym/FeedingJaco-v1", policy, str(folder / people), episodes, 0)
                figures = ("success_rate", "force_mean_newton", "episodes_over_limit", "episodes")
                figures_file.add(FILE, name, figures_file.chosen(row, figures))
            found = figures_file.read(FILE)[name]
            yield (
                f"| {policy} | {people} | {found['success_rate']:.2f} | {found['force_mean_newton']:.2f} | "
                f"{found['episodes_over_limit']} of {found['episodes']} |"
            )


def main() -> None:
    command, folder, *count = sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:])
    match command:
        case "simulate":
            simulate(folder, folder / "group.toml", count[0] if count else 40, SEED)
        case "recover":
            print(*recover(folder), sep="\n")
        case "distinguish":
            print(*distinguish(folder), sep="\n")
        case "use":
            print(*use(folder), sep="\n")
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
