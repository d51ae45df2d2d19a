"""Names of the populations of simulated people, and of their impairments."""

from collections.abc import Mapping

from avrgym.people.zoo.styles import COMMANDING_STYLE_NAME, STYLES

ORIGINAL_POPULATION, REVISED_POPULATION, PARTICIPANT_POPULATION = "original", "revised", "participants"
ANTHROPOMETRIC_POPULATION = "anthropometric"
TRAIN_ZOO, UNSEEN_ZOO, EXTREME_ZOO = "zoo/train", "zoo/unseen", "zoo/extreme"
POPULATION_NAMES = (
    ORIGINAL_POPULATION,
    REVISED_POPULATION,
    PARTICIPANT_POPULATION,
    ANTHROPOMETRIC_POPULATION,
    TRAIN_ZOO,
    UNSEEN_ZOO,
    EXTREME_ZOO,
)
ALLOWED_PEOPLE_TEXT = (
    f"{', '.join(POPULATION_NAMES)}, a style of the zoo such as {TRAIN_ZOO}/startled "
    f"({', '.join([*STYLES, COMMANDING_STYLE_NAME])}), one of these with @1 for motion version 1, a people file, "
    "the policy file of a trained human, or a folder of such policy files"
)
"""Text with the allowed values of ``people``, for help and error messages."""

ImpairmentName = str
"""A name in ``IMPAIRMENTS``. A clinical impairment may have a severity: ``spasticity:severe``."""
ASSISTIVE_GYM_IMPAIRMENTS: tuple[ImpairmentName, ...] = ("none", "limits", "weakness", "tremor")
"""Names of the impairments of Assistive Gym (Erickson et al., ICRA 2020), and ``none``."""
_DEGREES = ("mild", "moderate", "severe")
SEVERITIES: Mapping[ImpairmentName, tuple[str, ...]] = {
    "spasticity": _DEGREES,
    "hemiparesis_left": _DEGREES,
    "hemiparesis_right": _DEGREES,
    "spinal_cord_injury": ("C6", "C5", "C4"),
    "ataxia": _DEGREES,
    "dyskinesia": _DEGREES,
}
"""Severities of each clinical impairment, the least severe first."""
IMPAIRMENTS: tuple[ImpairmentName, ...] = (*ASSISTIVE_GYM_IMPAIRMENTS, *SEVERITIES)
ALLOWED_IMPAIRMENTS_TEXT = (
    f"{', '.join(IMPAIRMENTS)}; clinical impairments also with a severity, such as spasticity:severe "
    f"({', '.join(_DEGREES)}) or spinal_cord_injury:C5 ({', '.join(SEVERITIES['spinal_cord_injury'])})"
)
"""Text with the allowed values of ``impairment``, for help and error messages."""
