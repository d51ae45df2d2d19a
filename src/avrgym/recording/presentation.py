"""Presentation preferences: the size, position and contrast of texts, captions and reading aloud."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Contrast = Literal["normal", "high"]
PanelPosition = Literal["left", "centre", "right"]
PREFERENCE_RANGES = {"text_deg": (1.0, 3.0), "panel_distance_m": (0.75, 2.0)}
"""Minimum and maximum of each numerical preference."""


class PresentationPreferences(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Presentation of texts and sounds to a participant.

    ``text_deg`` determines the size of the whole panel in VR: at 1.5° the panel is 31° wide. On the page without a
    headset, it determines the font size in proportion.

    Raises:
        ValueError: for a value out of range.
    """

    text_deg: Annotated[
        float, Meta(description="Font size of questionnaire items in VR, degrees of visual angle.")
    ] = 1.5
    panel_distance_m: Annotated[float, Meta(description="Preferred distance of the panel from the eyes.")] = (
        1.25
    )
    contrast: Annotated[Contrast, Meta(description="`high`: white and yellow on black.")] = "normal"
    position: Annotated[
        PanelPosition,
        Meta(
            description="Side of the panel, for example for hemianopia. Up to a font size of 1.9°, the whole panel is "
            "on this side of straight ahead; larger panels begin in the middle."
        ),
    ] = "centre"
    reduced_motion: Annotated[
        bool, Meta(description="The scene and the dwell ring move in steps instead of smoothly.")
    ] = False
    read_aloud: Annotated[bool, Meta(description="Texts and highlighted buttons are read aloud.")] = False
    captions: Annotated[bool, Meta(description="A caption describes each sound.")] = False

    def __post_init__(self) -> None:
        for name, (low, high) in PREFERENCE_RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")

    def describe(self) -> str:
        """Returns a line of English text with the preferences that differ from the defaults."""
        default = PresentationPreferences()
        words = {
            "text_deg": f"text {self.text_deg:g}°",
            "panel_distance_m": f"panel at {self.panel_distance_m:g} m",
            "contrast": f"{self.contrast} contrast",
            "position": f"panel on the {self.position}",
            "reduced_motion": "reduced motion",
            "read_aloud": "read aloud",
            "captions": "captions",
        }
        return "; ".join(words[name] for name in words if getattr(self, name) != getattr(default, name))
