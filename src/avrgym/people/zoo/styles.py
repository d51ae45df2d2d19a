"""Behaviour styles of the zoo: descriptions, parameter ranges and their sources.

A style has at most three axes: delay, amplitude and tempo. Along an axis, some ``BehaviourParameters`` change from a
first to a last value. All other parameters have their default values.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

ParameterRanges = Mapping[str, tuple[float, float]]
"""First and last value of each parameter on an axis, by parameter name."""


@dataclass(frozen=True)
class BehaviourStyle:
    """A behaviour style, its parameter ranges along each axis, and their sources."""

    description: str
    source: str
    delay_ranges: ParameterRanges = field(default_factory=dict[str, tuple[float, float]])
    amplitude_ranges: ParameterRanges = field(default_factory=dict[str, tuple[float, float]])
    tempo_ranges: ParameterRanges = field(default_factory=dict[str, tuple[float, float]])

    @property
    def axis_ranges(self) -> tuple[ParameterRanges, ...]:
        """The parameter ranges of the three axes: delay, amplitude and tempo."""
        return self.delay_ranges, self.amplitude_ranges, self.tempo_ranges


SIMPLE_REACTION_RANGES: ParameterRanges = {"reaction_s": (0.2, 0.4)}
"""Reaction times in seconds. Simple visual reactions take 0.23 s on average, and longer with age (Woods et al., Front.
Hum. Neurosci. 9:131, 2015).
"""
APPROACH_RANGES: ParameterRanges = {"facing_share": (0.3, 0.7), "approach_share": (0.5, 1.1)}
SWAY_AMPLITUDE_RANGES: ParameterRanges = {"sway_deg": (0.3, 1.0)}
SWAY_FREQUENCY_RANGES: ParameterRanges = {"sway_hz": (0.1, 0.3)}
"""Frequencies of sway in Hz, up to the rate of quiet breathing."""
SLOW_SPEED_RANGES: ParameterRanges = {"speed_share": (0.5, 0.9)}
"""Speeds of slow people, relative to the limits of ``people.motor_model``."""
USUAL_SPEED_RANGES: ParameterRanges = {"speed_share": (0.82, 1.18)}

STYLES: Mapping[str, BehaviourStyle] = {
    "still": BehaviourStyle(
        "keep their initial pose, except for sway",
        "our assumption, as for participants",
        amplitude_ranges={"sway_deg": (0.2, 0.6)},
        tempo_ranges={"sway_hz": (0.08, 0.33)},
    ),
    "cooperating": BehaviourStyle(
        "face the tool, and bring mouth or arm to it when it is near",
        "delay: Woods et al. 2015; the rest our assumption, as for participants",
        delay_ranges=SIMPLE_REACTION_RANGES,
        amplitude_ranges=APPROACH_RANGES | SWAY_AMPLITUDE_RANGES,
        tempo_ranges=USUAL_SPEED_RANGES | SWAY_FREQUENCY_RANGES,
    ),
    "hesitant": BehaviourStyle(
        "wait before they come to the tool, stop half-way, and come slowly",
        "hesitant reaches of people who meet another person's hand: Moon et al., IROS 2011; the "
        "times are our assumption",
        delay_ranges={"reaction_s": (0.3, 0.6), "pause_s": (0.8, 2.4)},
        amplitude_ranges={"facing_share": (0.2, 0.6), "approach_share": (0.3, 0.9)} | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"speed_share": (0.4, 0.8)} | SWAY_FREQUENCY_RANGES,
    ),
    "startled": BehaviourStyle(
        "start when the tool comes close, withdraw, and get used to it: half as far each time",
        "the neck moves first, and the response decreases with repetition: Brown et al., Brain "
        "114:1891, 1991; involuntary motion near robots: "
        "Kirschner et al., RA-L 7(2), 2022; delay between that of a startle and that of Woods et "
        "al. 2015; the angles are our assumption",
        delay_ranges={"reaction_s": (0.14, 0.28)},
        amplitude_ranges={
            "startle_deg": (8.0, 18.0),
            "startle_distance_m": (0.14, 0.28),
            "approach_share": (0.2, 0.6),
        }
        | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"startle_duration_s": (0.6, 1.8), "facing_share": (0.3, 0.7)} | SWAY_FREQUENCY_RANGES,
    ),
    "averse": BehaviourStyle(
        "lean away from the tool and turn the face or draw the arm from it, as long as it is near",
        "delay: Woods et al. 2015; the angles are our assumption",
        delay_ranges=SIMPLE_REACTION_RANGES,
        amplitude_ranges={"withdrawal_deg": (4.0, 12.0), "facing_share": (0.1, 0.4)} | SWAY_AMPLITUDE_RANGES,
        tempo_ranges=SLOW_SPEED_RANGES | SWAY_FREQUENCY_RANGES,
    ),
    "talking": BehaviourStyle(
        "turn to a neighbour again and again",
        "faces turned to each other for 2.2 s at a time and 60 % of a conversation: Rogers et al., Sci. Rep. 8:4324, "
        "2018; meals in company: Ondras et al., CoRL 2022; the angles are our assumption",
        delay_ranges={"reaction_s": (0.3, 0.5)},
        amplitude_ranges={"glance_deg": (25.0, 50.0), "random_glance_deg": (2.0, 6.0)}
        | APPROACH_RANGES
        | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"glance_period_s": (3.6, 8.0), "glance_share": (0.35, 0.6)} | SWAY_FREQUENCY_RANGES,
    ),
    "chewing": BehaviourStyle(
        "chew, and the head moves with the jaw",
        "0.94 to 2.17 Hz, 5th to 95th percentile: Po et al., J. Dent. Res. 90:1206, 2011; the head moves with the jaw: "
        "Häggman-Henrikson and Eriksson, J. Dent. Res. 83:864, 2004; the angles are our assumption",
        delay_ranges=SIMPLE_REACTION_RANGES,
        amplitude_ranges={"chew_deg": (1.0, 3.0)} | APPROACH_RANGES | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"chew_hz": (0.94, 2.17)} | SWAY_FREQUENCY_RANGES,
    ),
    "distracted": BehaviourStyle(
        "look about, each time elsewhere, and notice the tool late",
        "our assumption",
        delay_ranges={"reaction_s": (0.5, 0.9)},
        amplitude_ranges={
            "random_glance_deg": (25.0, 55.0),
            "facing_share": (0.1, 0.5),
            "approach_share": (0.2, 0.8),
        }
        | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"glance_period_s": (2.5, 6.5), "glance_share": (0.5, 0.8)} | SWAY_FREQUENCY_RANGES,
    ),
    "restless": BehaviourStyle(
        "shift in their seat every few seconds",
        "comfortable postures of one person differ by about 10°: Chen et al., Healthcare 9:1685, 2021; how often is "
        "our assumption",
        delay_ranges=SIMPLE_REACTION_RANGES,
        amplitude_ranges={"shift_deg": (3.0, 8.0)} | APPROACH_RANGES | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"shift_period_s": (2.0, 6.0)} | SWAY_FREQUENCY_RANGES,
    ),
    "trembling": BehaviourStyle(
        "cooperate while head and arms tremble at 5 Hz",
        "4 to 12 Hz: Bhatia et al., Mov. Disord. 33:75, 2018; amplitudes below the joint targets of Assistive Gym, 20°",
        delay_ranges=SIMPLE_REACTION_RANGES,
        amplitude_ranges={"tremor_deg": (2.0, 8.0)} | APPROACH_RANGES | SWAY_AMPLITUDE_RANGES,
        tempo_ranges=SLOW_SPEED_RANGES | SWAY_FREQUENCY_RANGES,
    ),
    "weak": BehaviourStyle(
        "cooperate with little strength, slowly, and not far",
        "strength within the range of Assistive Gym; the rest our assumption",
        delay_ranges={"reaction_s": (0.3, 0.5)},
        amplitude_ranges={
            "strength_share": (0.25, 0.6),
            "facing_share": (0.2, 0.5),
            "approach_share": (0.2, 0.7),
        }
        | SWAY_AMPLITUDE_RANGES,
        tempo_ranges={"speed_share": (0.4, 0.7)} | SWAY_FREQUENCY_RANGES,
    ),
    "limited": BehaviourStyle(
        "cooperate with reduced joint ranges",
        "ranges within those of Assistive Gym",
        delay_ranges=SIMPLE_REACTION_RANGES,
        amplitude_ranges={"range_share": (0.5, 0.9)} | APPROACH_RANGES | SWAY_AMPLITUDE_RANGES,
        tempo_ranges=SLOW_SPEED_RANGES | SWAY_FREQUENCY_RANGES,
    ),
}
"""Behaviour styles by name. "Assistive Gym" is Erickson et al., ICRA 2020."""

ASSUMPTION = "assumption"
PARAMETER_SOURCES: Mapping[str, str] = {
    "reaction_s": "Woods et al. 2015; hesitant, talking, distracted and weak people: assumption",
    "facing_share": ASSUMPTION,
    "approach_share": ASSUMPTION,
    "pause_s": "assumption; that people pause: Moon et al. 2011",
    "withdrawal_deg": ASSUMPTION,
    "startle_deg": "assumption; that it habituates: Brown et al. 1991",
    "startle_distance_m": ASSUMPTION,
    "startle_duration_s": ASSUMPTION,
    "glance_deg": ASSUMPTION,
    "random_glance_deg": ASSUMPTION,
    "glance_period_s": "talking people: Rogers et al. 2018; distracted people: assumption",
    "glance_share": "talking people: Rogers et al. 2018; distracted people: assumption",
    "chew_deg": "assumption; that the head moves: Häggman-Henrikson and Eriksson 2004",
    "chew_hz": "Po et al. 2011",
    "shift_deg": "Chen et al. 2021",
    "shift_period_s": ASSUMPTION,
    "sway_deg": ASSUMPTION,
    "sway_hz": ASSUMPTION,
    "speed_share": ASSUMPTION,
    "tremor_deg": "Erickson et al. 2020",
    "tremor_hz": "Erickson et al. 2020; fitted people: 4 to 12 Hz, Bhatia et al. 2018",
    "strength_share": "Erickson et al. 2020",
    "range_share": "Erickson et al. 2020",
}
"""Source of each behaviour parameter's range. ``BehaviourStyle.source`` contains the references."""

COMMANDING_STYLE_NAME = "commanding"
COMMANDING_STYLE = BehaviourStyle(
    "cooperate, and command the robot: ready when it waits, slower or faster to a comfortable speed, sometimes wait",
    "motion as cooperating; the commands are our assumption",
    delay_ranges=SIMPLE_REACTION_RANGES | {"ready_delay_s": (0.6, 2.5)},
    amplitude_ranges=APPROACH_RANGES | SWAY_AMPLITUDE_RANGES | {"comfortable_speed": (0.5, 1.1)},
    tempo_ranges=USUAL_SPEED_RANGES | SWAY_FREQUENCY_RANGES | {"wait_commands_per_min": (0.0, 6.0)},
)
"""The style of partners that give commands, see ``people.zoo.commanding``. Only its own populations contain it."""
COMMAND_PARAMETER_SOURCES: Mapping[str, str] = {
    "ready_delay_s": ASSUMPTION,
    "comfortable_speed": ASSUMPTION,
    "wait_commands_per_min": ASSUMPTION,
}
"""Literature source (or assumption) of the range of each parameter of ``CommandParameters``."""
