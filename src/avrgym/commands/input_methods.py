"""Names of the input methods and of the stop methods of participants."""

from typing import Literal, get_args

InputMethod = Literal[
    "controllers", "hands", "left-hand", "right-hand", "head", "one-switch", "two-switches", "experimenter"
]
INPUT_METHODS: tuple[InputMethod, ...] = get_args(InputMethod)
StopInput = Literal["buttons", "palm", "gaze", "switch", "experimenter"]
STOP_INPUTS: tuple[StopInput, ...] = get_args(StopInput)
