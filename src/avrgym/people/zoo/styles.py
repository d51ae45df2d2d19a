"""The styles of the zoo: what people of each do, within which ranges, and where the ranges come from.

A style has up to three axes, its delay, its amplitude and its tempo. Each moves some of the traits of
``BehaviourParameters`` from a first to a last value; what a style does not name keeps the value of
``BehaviourParameters``'s own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

Ranges = Mapping[str, tuple[float, float]]
"""First and last value of traits, by name."""


@dataclass(frozen=True)
class Style:
    """What people of a style do, how their traits move along its axes, and the sources of the ranges."""

    does: str
    source: str
    delay: Ranges = field(default_factory=dict[str, tuple[float, float]])
    amplitude: Ranges = field(default_factory=dict[str, tuple[float, float]])
    tempo: Ranges = field(default_factory=dict[str, tuple[float, float]])

    @property
    def axes(self) -> tuple[Ranges, ...]:
        """Delay, amplitude and tempo."""
        return self.delay, self.amplitude, self.tempo


ATTENTIVE: Ranges = {"reaction_s": (0.2, 0.4)}
"""Simple reactions to what is seen take 0.23 s on average, and longer with age (Woods et al., Front. Hum. Neurosci.
9:131, 2015)."""
WILLING: Ranges = {"facing_share": (0.3, 0.7), "approach_share": (0.5, 1.1)}
SWAYING: Ranges = {"sway_deg": (0.3, 1.0)}
SWAYING_PACE: Ranges = {"sway_hz": (0.1, 0.3)}
"""The pace of quiet breathing and slower."""
UNHURRIED: Ranges = {"speed_share": (0.5, 0.9)}
BRISK: Ranges = {"speed_share": (0.82, 1.18)}

STYLES: Mapping[str, Style] = {
    "still": Style(
        "stay as they were found, but for the sway that nobody is without",
        "our assumption, as of participants",
        amplitude={"sway_deg": (0.2, 0.6)},
        tempo={"sway_hz": (0.08, 0.33)},
    ),
    "cooperating": Style(
        "face the tool, and bring mouth or arm to it when it is near",
        "delay: Woods et al. 2015; the rest our assumption, as of participants",
        delay=ATTENTIVE,
        amplitude=WILLING | SWAYING,
        tempo=BRISK | SWAYING_PACE,
    ),
    "hesitant": Style(
        "wait before they come to the tool, stop half-way, and come slowly",
        "halting reaches of people who meet another's: Moon et al., IROS 2011; the times are our assumption",
        delay={"reaction_s": (0.3, 0.6), "pause_s": (0.8, 2.4)},
        amplitude={"facing_share": (0.2, 0.6), "approach_share": (0.3, 0.9)} | SWAYING,
        tempo={"speed_share": (0.4, 0.8)} | SWAYING_PACE,
    ),
    "startled": Style(
        "start when the tool comes close, withdraw, and get used to it: half as far each time",
        "first the neck, and less each time: Brown et al., Brain 114:1891, 1991; involuntary motion near robots: "
        "Kirschner et al., RA-L 7(2), 2022; delay between startle and Woods et al. 2015; the angles are our assumption",
        delay={"reaction_s": (0.14, 0.28)},
        amplitude={"startle_deg": (8.0, 18.0), "startle_m": (0.14, 0.28), "approach_share": (0.2, 0.6)}
        | SWAYING,
        tempo={"startle_s": (0.6, 1.8), "facing_share": (0.3, 0.7)} | SWAYING_PACE,
    ),
    "averse": Style(
        "lean away from the tool and turn the face or draw the arm from it, as long as it is near",
        "delay: Woods et al. 2015; the angles are our assumption",
        delay=ATTENTIVE,
        amplitude={"away_deg": (4.0, 12.0), "facing_share": (0.1, 0.4)} | SWAYING,
        tempo=UNHURRIED | SWAYING_PACE,
    ),
    "talking": Style(
        "turn to somebody beside them again and again",
        "faces turned to each other for 2.2 s at a time and 60 % of a conversation: Rogers et al., Sci. Rep. 8:4324, "
        "2018; meals in company: Ondras et al., CoRL 2022; the angles are our assumption",
        delay={"reaction_s": (0.3, 0.5)},
        amplitude={"glance_deg": (25.0, 50.0), "wander_deg": (2.0, 6.0)} | WILLING | SWAYING,
        tempo={"glance_every_s": (3.6, 8.0), "glance_share": (0.35, 0.6)} | SWAYING_PACE,
    ),
    "chewing": Style(
        "chew, and the head moves with the jaw",
        "0.94 to 2.17 Hz, 5th to 95th percentile: Po et al., J. Dent. Res. 90:1206, 2011; the head moves with the jaw: "
        "Häggman-Henrikson and Eriksson, J. Dent. Res. 83:864, 2004; the angles are our assumption",
        delay=ATTENTIVE,
        amplitude={"chew_deg": (1.0, 3.0)} | WILLING | SWAYING,
        tempo={"chew_hz": (0.94, 2.17)} | SWAYING_PACE,
    ),
    "distracted": Style(
        "look about, each time elsewhere, and notice the tool late",
        "our assumption",
        delay={"reaction_s": (0.5, 0.9)},
        amplitude={"wander_deg": (25.0, 55.0), "facing_share": (0.1, 0.5), "approach_share": (0.2, 0.8)}
        | SWAYING,
        tempo={"glance_every_s": (2.5, 6.5), "glance_share": (0.5, 0.8)} | SWAYING_PACE,
    ),
    "restless": Style(
        "shift in their seat every few seconds",
        "comfortable postures of one person differ by about 10°: Chen et al., Healthcare 9:1685, 2021; how often is "
        "our assumption",
        delay=ATTENTIVE,
        amplitude={"shift_deg": (3.0, 8.0)} | WILLING | SWAYING,
        tempo={"shift_every_s": (2.0, 6.0)} | SWAYING_PACE,
    ),
    "trembling": Style(
        "cooperate while head and arms tremble at 5 Hz",
        "4 to 12 Hz: Bhatia et al., Mov. Disord. 33:75, 2018; amplitudes within where Assistive Gym sends joints, 20°",
        delay=ATTENTIVE,
        amplitude={"tremor_deg": (2.0, 8.0)} | WILLING | SWAYING,
        tempo=UNHURRIED | SWAYING_PACE,
    ),
    "weak": Style(
        "cooperate with little strength, slowly, and not far",
        "strength within the range of Assistive Gym; the rest our assumption",
        delay={"reaction_s": (0.3, 0.5)},
        amplitude={"strength_share": (0.25, 0.6), "facing_share": (0.2, 0.5), "approach_share": (0.2, 0.7)}
        | SWAYING,
        tempo={"speed_share": (0.4, 0.7)} | SWAYING_PACE,
    ),
    "limited": Style(
        "cooperate with joints that do not turn as far",
        "ranges within those of Assistive Gym",
        delay=ATTENTIVE,
        amplitude={"range_share": (0.5, 0.9)} | WILLING | SWAYING,
        tempo=UNHURRIED | SWAYING_PACE,
    ),
}
"""By name. Assistive Gym's impairments: Erickson et al., ICRA 2020."""
