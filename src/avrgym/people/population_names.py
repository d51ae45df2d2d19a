"""Names of populations and impairments."""

from typing import Literal, get_args

from avrgym.people.zoo.styles import STYLES

ORIGINAL, REVISED, PARTICIPANTS = "original", "revised", "participants"
TRAIN_ZOO, UNSEEN_ZOO = "zoo/train", "zoo/unseen"
POPULATION_NAMES = (ORIGINAL, REVISED, PARTICIPANTS, TRAIN_ZOO, UNSEEN_ZOO)
ALLOWED_PEOPLE = (
    f"{', '.join(POPULATION_NAMES)}, a style of the zoo such as {TRAIN_ZOO}/startled "
    f"({', '.join(STYLES)}), a file of people, a trained human, or a folder of those"
)
"""The allowed values of ``people``, for help and error messages."""

Impairment = Literal["none", "limits", "weakness", "tremor"]
IMPAIRMENTS: tuple[Impairment, ...] = get_args(Impairment)
