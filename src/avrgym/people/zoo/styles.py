"""Behaviour styles of the zoo: descriptions, parameter ranges and their sources.

A style has at most three axes: delay, amplitude and tempo. Along an axis, some ``BehaviourParameters`` change from a
first to a last value. All other parameters have their default values.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

Ranges = Mapping[str, tuple[float, float]]
"""First and last value of each parameter on an axis, by parameter name."""


@dataclass(frozen=True)
class Style:
    """A behaviour style, its parameter ranges along each axis, and their sources."""

    description: str
    source: str
    delay: Ranges = field(default_factory=dict[str, tuple[float, float]])
    amplitude: Ranges = field(default_factory=dict[str, tuple[float, float]])
    tempo: Ranges = field(default_factory=dict[str, tuple[float, float]])

    @property
    def axes(self) -> tuple[Ranges, ...]:
        """The parameter ranges of the three axes: delay, amplitude and tempo."""
        return self.delay, self.amplitude, self.tempo


SIMPLE_REACTION: Ranges = {"reaction_s": (0.2, 0.4)}
"""Simple visual reactions take 0.23 s on average, and longer with age (Woods et al., Front. Hum. Neurosci. 9:131,
2015)."""
APPROACH: Ranges = {"facing_share": (0.3, 0.7), "approach_share": (0.5, 1.1)}
SWAY: Ranges = {"sway_deg": (0.3, 1.0)}
SWAY_RATE: Ranges = {"sway_hz": (0.1, 0.3)}
"""Frequencies of sway in Hz, up to the rate of quiet breathing."""
SLOW: Ranges = {"speed_share": (0.5, 0.9)}
"""Speeds of slow people, relative to the limits of ``people.motor``."""
USUAL_SPEED: Ranges = {"speed_share": (0.82, 1.18)}

STYLES: Mapping[str, Style] = {
    "still": Style(
        "keep their initial pose, except for sway",
        "our assumption, as for participants",
        amplitude={"sway_deg": (0.2, 0.6)},
        tempo={"sway_hz": (0.08, 0.33)},
    ),
    "cooperating": Style(
        "face the tool, and bring mouth or arm to it when it is near",
        "delay: Woods et al. 2015; the rest our assumption, as for participants",
        delay=SIMPLE_REACTION,
        amplitude=APPROACH | SWAY,
        tempo=USUAL_SPEED | SWAY_RATE,
    ),
    "hesitant": Style(
        "wait before they come to the tool, stop half-way, and come slowly",
        "hesitant reaches of people who meet another person's hand: Moon et al., IROS 2011; the "
        "times are our assumption",
        delay={"reaction_s": (0.3, 0.6), "pause_s": (0.8, 2.4)},
        amplitude={"facing_share": (0.2, 0.6), "approach_share": (0.3, 0.9)} | SWAY,
        tempo={"speed_share": (0.4, 0.8)} | SWAY_RATE,
    ),
    "startled": Style(
        "start when the tool comes close, withdraw, and get used to it: half as far each time",
        "the neck moves first, and the response decreases with repetition: Brown et al., Brain "
        "114:1891, 1991; involuntary motion near robots: "
        "Kirschner et al., RA-L 7(2), 2022; delay between that of a startle and that of Woods et "
        "al. 2015; the angles are our assumption",
        delay={"reaction_s": (0.14, 0.28)},
        amplitude={
            "startle_deg": (8.0, 18.0),
            "startle_distance_m": (0.14, 0.28),
            "approach_share": (0.2, 0.6),
        }
        | SWAY,
        tempo={"startle_duration_s": (0.6, 1.8), "facing_share": (0.3, 0.7)} | SWAY_RATE,
    ),
    "averse": Style(
        "lean away from the tool and turn the face or draw the arm from it, as long as it is near",
        "delay: Woods et al. 2015; the angles are our assumption",
        delay=SIMPLE_REACTION,
        amplitude={"withdrawal_deg": (4.0, 12.0), "facing_share": (0.1, 0.4)} | SWAY,
        tempo=SLOW | SWAY_RATE,
    ),
    "talking": Style(
        "turn to a neighbour again and again",
        "faces turned to each other for 2.2 s at a time and 60 % of a conversation: Rogers et al., Sci. Rep. 8:4324, "
        "2018; meals in company: Ondras et al., CoRL 2022; the angles are our assumption",
        delay={"reaction_s": (0.3, 0.5)},
        amplitude={"glance_deg": (25.0, 50.0), "random_glance_deg": (2.0, 6.0)} | APPROACH | SWAY,
        tempo={"glance_period_s": (3.6, 8.0), "glance_share": (0.35, 0.6)} | SWAY_RATE,
    ),
    "chewing": Style(
        "chew, and the head moves with the jaw",
        "0.94 to 2.17 Hz, 5th to 95th percentile: Po et al., J. Dent. Res. 90:1206, 2011; the head moves with the jaw: "
        "Häggman-Henrikson and Eriksson, J. Dent. Res. 83:864, 2004; the angles are our assumption",
        delay=SIMPLE_REACTION,
        amplitude={"chew_deg": (1.0, 3.0)} | APPROACH | SWAY,
        tempo={"chew_hz": (0.94, 2.17)} | SWAY_RATE,
    ),
    "distracted": Style(
        "look about, each time elsewhere, and notice the tool late",
        "our assumption",
        delay={"reaction_s": (0.5, 0.9)},
        amplitude={
            "random_glance_deg": (25.0, 55.0),
            "facing_share": (0.1, 0.5),
            "approach_share": (0.2, 0.8),
        }
        | SWAY,
        tempo={"glance_period_s": (2.5, 6.5), "glance_share": (0.5, 0.8)} | SWAY_RATE,
    ),
    "restless": Style(
        "shift in their seat every few seconds",
        "comfortable postures of one person differ by about 10°: Chen et al., Healthcare 9:1685, 2021; how often is "
        "our assumption",
        delay=SIMPLE_REACTION,
        amplitude={"shift_deg": (3.0, 8.0)} | APPROACH | SWAY,
        tempo={"shift_period_s": (2.0, 6.0)} | SWAY_RATE,
    ),
    "trembling": Style(
        "cooperate while head and arms tremble at 5 Hz",
        "4 to 12 Hz: Bhatia et al., Mov. Disord. 33:75, 2018; amplitudes below the joint targets of Assistive Gym, 20°",
        delay=SIMPLE_REACTION,
        amplitude={"tremor_deg": (2.0, 8.0)} | APPROACH | SWAY,
        tempo=SLOW | SWAY_RATE,
    ),
    "weak": Style(
        "cooperate with little strength, slowly, and not far",
        "strength within the range of Assistive Gym; the rest our assumption",
        delay={"reaction_s": (0.3, 0.5)},
        amplitude={"strength_share": (0.25, 0.6), "facing_share": (0.2, 0.5), "approach_share": (0.2, 0.7)}
        | SWAY,
        tempo={"speed_share": (0.4, 0.7)} | SWAY_RATE,
    ),
    "limited": Style(
        "cooperate with reduced joint ranges",
        "ranges within those of Assistive Gym",
        delay=SIMPLE_REACTION,
        amplitude={"range_share": (0.5, 0.9)} | APPROACH | SWAY,
        tempo=SLOW | SWAY_RATE,
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
"""Source of each behaviour parameter's range. ``Style.source`` contains the references."""

COMMANDING = "commanding"
COMMANDING_STYLE = Style(
    "cooperate, and command the robot: ready when it waits, slower or faster to a comfortable speed, sometimes wait",
    "motion as cooperating; the commands are our assumption",
    delay=SIMPLE_REACTION | {"ready_delay_s": (0.6, 2.5)},
    amplitude=APPROACH | SWAY | {"comfortable_speed": (0.5, 1.1)},
    tempo=USUAL_SPEED | SWAY_RATE | {"wait_per_min": (0.0, 6.0)},
)
"""The style of partners that give commands, see ``people.zoo.commanding``. Only its own populations contain it."""
COMMAND_SOURCES: Mapping[str, str] = {
    "ready_delay_s": ASSUMPTION,
    "comfortable_speed": ASSUMPTION,
    "wait_per_min": ASSUMPTION,
}
"""Source of the range of each parameter of ``CommandParameters``."""
