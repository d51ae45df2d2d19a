"""What every column of the analysis' tables means, as far as the export's codebook does not say it already."""

from collections.abc import Mapping

from avrgym.study.checking.repeats import REASONS
from avrgym.study.export.codebook import (
    LABELS,
    NUMBER,
    POLICY,
    REWARD,
    SIMULATED,
    SUCCESS,
    TABLES,
    TEXT,
    TRUTH,
    WHOLE,
    Column,
)

_TRUTH, _SHARE, _P = "true, false", "0 to 1", "0 to 1"


_FROM_0 = "0 and above"


_RAN_NEVER = "the trial is not completed"


_NO_RECORDING = "no whole recording tells it"


_NOT_TESTED = "nothing could be tested"


_NO_ESTIMATE = "there is no estimate"


_NOT_SIMULATED = "the policy was not measured in simulation"


_NO_REWARDS = f"{_NOT_SIMULATED}, or all rewards are equal"


_FEW = "too few values"


_FEW_OR_EQUAL = "too few values, or all are equal"


_NO_EFFECT_INTERVAL = "no effect, a test by trial, an energy distance, or too few participants"


_NOT_PRIMARY = "no primary result, or nothing could be tested"


_NO_INTERVAL = "no trial, or several of one participant"


_SESSION = "it is about whole sessions"


def _number(meaning: str, unit: str = "1", empty: str = "", allowed: str = "") -> Column:
    return Column(meaning, NUMBER, unit, allowed, empty)


def _whole(meaning: str, empty: str = "", allowed: str = _FROM_0) -> Column:
    return Column(meaning, WHOLE, "", allowed, empty)


def _text(meaning: str, empty: str = "") -> Column:
    return Column(meaning, TEXT, "", "", empty)


def _head(axis: str) -> Column:
    return _number(f"Centre of the head along {axis}, world frame: mean over the trial.", "m", _NO_RECORDING)


def _waist(axis: str, what: str) -> Column:
    return _number(f"Angle of the waist about {axis} in the trial: {what}.", "°", _NO_RECORDING)


COLUMNS: Mapping[str, Column] = {
    **{name: LABELS[name] for name in LABELS},
    **{name: TABLES["participants"][name] for name in ("state", "sex", "age_years")},
    **{name: TABLES["answers"][name] for name in ("moment", "questionnaire", "item", "value", "points")},
    **{name: TABLES["scores"][name] for name in ("instrument", "scale", "score", "answered", "items")},
    **{f"items.{name}": TABLES["items"][name] for name in ("item", "text", "least", "most", "points", "low", "high")},
    "items.version": _whole(
        "Version of the item: 2 and above where it was changed after somebody had answered it.",
        allowed="1 and above",
    ),
    "items.asked_of": _text("The participants who answered it."),
    "items.answers": _whole("How many answers there are to it.", allowed="1 and above"),
    "response_time_s": TABLES["answers"]["response_time_s"],
    "participant_state": TABLES["participants"]["state"],
    "seed": TABLES["trials"]["seed"],
    "steps": TABLES["attempts"]["steps"],
    "seconds": TABLES["attempts"]["seconds"],
    "reward": Column(REWARD.meaning, NUMBER, "1", "", _RAN_NEVER),
    "success": Column(SUCCESS.meaning, TRUTH, "", _TRUTH, _RAN_NEVER),
    "recording": Column("File of the recording in the study's folder.", TEXT, empty=_RAN_NEVER),
    "torso_height_m": _number("Torso height, hip bone to centre of the head, as calibrated.", "m", _NO_RECORDING),
    "sessions": _whole("How many sessions there were."),
    "trials": _whole("How many trials there are."),
    "trials_completed": _whole("How many trials were completed."),
    "trials_missing": _whole("How many planned trials were not completed."),
    "attempts": _whole("How many attempts were made."),
    "attempts_broken_off": _whole("How many attempts did not complete their trial."),
    "repeats.trials": _whole("How many trials of the condition were begun, practice left out."),
    "reason": Column("What led to the repeats.", TEXT, allowed=", ".join(REASONS)),
    "cause": _text("The cause in words."),
    "ordered_by": _text("Who ordered the repeats.", "no experimenter did"),
    "repeated": _whole("How many trials were repeated for this cause."),
    "replaced": _whole("How many attempts a later attempt replaced."),
    "replaced_successes": _whole("In how many of these the robot had succeeded."),
    "success_unknown": _whole("Of how many of these no outcome is stored."),
    "counted": Column("Whether it enters the analyses.", TRUTH, allowed=_TRUTH),
    "left_out": _text("Why a trial that was completed does not count.", "it counts, or was not completed"),
    "held_share": _number(
        "Share of the robot's time in which the person was held still, as tracking was lost or jumped.",
        "1", _NO_RECORDING, _SHARE,
    ),
    "recorded": _text("How the recording is.", _RAN_NEVER),
    "reward_recorded": _number("The reward as summed from the recording.", "1", _NO_RECORDING),
    "distance_least_m": _number("Least distance to the target.", "m", _NO_RECORDING, _FROM_0),
    "force_mean_n": _number("Mean force of robot and tool on the person.", "N", _NO_RECORDING, _FROM_0),
    "force_peak_n": _number("Greatest force of robot and tool on the person.", "N", _NO_RECORDING, _FROM_0),
    "guard_interventions": _whole("How often the force guard acted.", "no force guard, or no recording"),
    **{f"head_{axis}_m": _head(axis) for axis in "xyz"},
    **{f"waist_{axis}_deg": _waist(axis, "mean") for axis in "xyz"},
    **{f"waist_{axis}_least_deg": _waist(axis, "least") for axis in "xyz"},
    **{f"waist_{axis}_most_deg": _waist(axis, "greatest") for axis in "xyz"},
    "term": _text("Name of the reward term."),
    "sum": _number("Sum of the term over the trial, not weighted."),
    "weight": _number("Weight of the term.", "1", "not recorded"),
    "weighted_sum": _number("Sum times weight.", "1", "not recorded"),
    "where": _text("What it is about."),
    "what": _text("What is not as it should be."),
    "consequence": _text("What follows from it for the analysis."),
    "reward_mean": _number("Mean reward.", "1", "no trial, or all tasks together"),
    "reward_low": _number("Lower end of its 95 % interval, Student's t.", "1", _FEW_OR_EQUAL),
    "reward_high": _number("Upper end of its 95 % interval, Student's t.", "1", _FEW_OR_EQUAL),
    "successes": _whole("How many trials succeeded."),
    "success_rate": _number("Share of trials that succeeded.", "1", "no trial", _SHARE),
    "success_low": _number("Lower end of its 95 % interval, Wilson's.", "1", _NO_INTERVAL, _SHARE),
    "success_high": _number("Upper end of its 95 % interval, Wilson's.", "1", _NO_INTERVAL, _SHARE),
    "simulation_people": _text("Simulated people with whom the policy was measured.", _NOT_SIMULATED),
    "simulation_episodes": _whole("Episodes of that measurement.", _NOT_SIMULATED),
    "simulation_reward_mean": _number("Mean reward in simulation.", "1", _NOT_SIMULATED),
    "simulation_reward_low": _number("Lower end of its 95 % interval.", "1", _NO_REWARDS),
    "simulation_reward_high": _number("Upper end of its 95 % interval.", "1", _NO_REWARDS),
    "simulation_success_rate": _number("Share of successes in simulation.", "1", _NOT_SIMULATED, _SHARE),
    "simulation_success_low": _number("Lower end of its 95 % interval.", "1", _NOT_SIMULATED, _SHARE),
    "simulation_success_high": _number("Upper end of its 95 % interval.", "1", _NOT_SIMULATED, _SHARE),
    "simulation_note": _text("What is to be said about the simulation.", "nothing"),
    "n": _whole("How many values there are, or went into a test."),
    "mean": _number("Mean of the values."),
    "deviation": _number("Their standard deviation.", "1", _FEW),
    "least": _number("The least value, or the least that a scale allows."),
    "lower_quartile": _number("Lower quartile, linear interpolation."),
    "median": _number("Median."),
    "upper_quartile": _number("Upper quartile, linear interpolation."),
    "most": _number("The greatest value, or the greatest that a scale allows."),
    "count": _whole("How often the value was chosen."),
    "share": _number("That as a share of all choices.", "1", "", _SHARE),
    "family": _text("What is corrected together."),
    "quantity": _text("What was measured; its unit stands at the end of its name."),
    "unit": _text("What one value stands for: a trial or a participant."),
    "group_a": _text("The first group of a comparison."),
    "group_b": _text("The second group of a comparison."),
    "test": _text("Which test."),
    "n_a": _whole("How many values the first group gave."),
    "n_b": _whole("How many values the second group gave."),
    "zeros": _whole("How many differences of zero were left out."),
    "median_a": _number("Median of the first group.", "1", "no values, or points in space"),
    "median_b": _number("Median of the second group.", "1", "no values, or points in space"),
    "statistic": _number("The test's statistic.", "1", _NOT_TESTED),
    "method": _text("How p was computed.", _NOT_TESTED),
    "p": _number("Two-sided probability of such data without an effect.", "1", _NOT_TESTED, _P),
    "p_holm": _number("p after Holm's correction within the family.", "1", _NOT_TESTED, _P),
    "p_primary": _number("p corrected over all primary results of the study.", "1", _NOT_PRIMARY, _P),
    "mark": _text("Stars for p_primary: * < 0.05, ** < 0.01, *** < 0.001.", "0.05 or more, or no primary result"),
    "role": _text("Role for its question: primary, sensitivity analysis, secondary or supplement."),
    "effect_low": _number("Lower end of the 95 % interval of the effect.", "1", _NO_EFFECT_INTERVAL, "-1 to 1"),
    "effect_high": _number("Upper end of the 95 % interval of the effect.", "1", _NO_EFFECT_INTERVAL, "-1 to 1"),
    "effect": _number(
        "Rank-biserial correlation, or for energy distances the share between groups.", "1", "no differences"
    ),
    "note": _text("Why nothing was tested or estimated, or what was left out.", "nothing"),
    "planned": _text("What it is by the study's frozen plan.", "no plan is known to be older than the study"),
    "problems.simulated": Column(SIMULATED.meaning, TRUTH, "", _TRUTH, "it is about the whole study"),
    "likert.value": _whole("A value of the item's own scale.", allowed="any of the scale"),
    "likert.policy": Column(POLICY.meaning, TEXT, "", POLICY.allowed, _SESSION),
    "streams.stream": _text("What the study calls the stream."),
    "streams.kind": _text("What the device says that it measures."),
    "streams.samples": _whole("How many samples were recorded."),
    "streams.rate_hz": _number("The rate that the device promises; 0 for samples at any time.", "Hz"),
    "streams.measured_hz": _number("The rate at which samples came.", "Hz"),
    "streams.offset_ms": _number("What was added to the device's clock: median over the trial.", "ms"),
    "streams.offset_range_ms": _number("The same from its least to its most in the trial.", "ms"),
    "streams.jitter_ms": _number(
        "Standard deviation of the samples' times about even spacing.", "ms", "no even spacing, or few samples"
    ),
    "streams.gaps": _whole("Where samples are missing between others.", "no even spacing, or few samples"),
    "streams.clock_resets": _whole("How often the device's clock jumped; times are corrected for it."),
    "streams.clock_jump_s": _number("The furthest jump; negative for a clock that jumped back.", "s"),
    "score_summaries.policy": Column(POLICY.meaning, TEXT, "", POLICY.allowed, _SESSION),
    "people.torso_height_m": _number("Torso height, hip bone to centre of the head.", "m"),
    **{f"people.waist_{axis}_deg": _number(f"Angle of the waist about {axis}.", "°") for axis in "xyz"},
    **{f"people.head_{axis}_m": _number(f"Centre of the head along {axis}, world frame.", "m") for axis in "xyz"},
    "models.effect": _text("Which kind of effect: policies, robots, learning, order or carry-over."),
    "model": _text("Which model: ordinal, logistic or mixed."),
    "participants": _whole("How many participants gave values."),
    "values": _whole("How many trials gave values."),
    "estimate": _number("The effect: log odds, or for mixed models the quantity's own unit.", "1", _NO_ESTIMATE),
    "error": _number("Its standard error.", "1", _NO_ESTIMATE, _FROM_0),
    "df": _number("Its degrees of freedom, Student's t.", "1", _NO_ESTIMATE, _FROM_0),
    "low": _number("Lower end of its 95 % interval.", "1", _NO_ESTIMATE),
    "high": _number("Upper end of its 95 % interval.", "1", _NO_ESTIMATE),
    "odds_ratio": _number("exp(estimate) of ordinal and logistic models.", "1", _NO_ESTIMATE, _FROM_0),
    "odds_ratio_low": _number("Lower end of its 95 % interval.", "1", _NO_ESTIMATE, _FROM_0),
    "odds_ratio_high": _number("Upper end of its 95 % interval.", "1", _NO_ESTIMATE, _FROM_0),
    "without_one": _whole("How many models without one participant could be fitted."),
    "without_one_least": _number("Least estimate without one participant.", "1", _NO_ESTIMATE),
    "without_one_most": _number("Greatest estimate without one participant.", "1", _NO_ESTIMATE),
    "without_one_p_least": _number("Least p without one participant.", "1", _NO_ESTIMATE, _P),
    "without_one_p_most": _number("Greatest p without one participant.", "1", _NO_ESTIMATE, _P),
    "stage": _text("Stage of the way from pose to picture; total_ms is the whole."),
    "pictures": _whole("How many tracking frames of counted trials a picture followed."),
    "p50_ms": _number("Median of what the stage took.", "ms", "", _FROM_0),
    "p95_ms": _number("95th percentile of what the stage took.", "ms", "", _FROM_0),
    "p99_ms": _number("99th percentile of what the stage took.", "ms", "", _FROM_0),
    "latency.participant": _text("Pseudonym.", "it is about all participants of its kind together"),
    "posture": _text("Seated, or in bed."),
    "people": _text("Whose bodies: participants, or people of the training."),
    "number": _whole("Number of the person within the task."),
    "original_low": _number("Lower end of the Original people's range."),
    "original_high": _number("Upper end of the Original people's range."),
    "original_covers": _number("Share of participants within it.", "1", "", _SHARE),
    "revised_low": _number("Lower end of the Revised people's range."),
    "revised_high": _number("Upper end of the Revised people's range."),
    "revised_covers": _number("Share of participants within it.", "1", "", _SHARE),
    **{name: TABLES["control_steps"][name] for name in ("step", "time_s", "distance_m", "force_on_person_n")},
}  # fmt: skip
"""By column; where a table's column means something else, by table and column."""
