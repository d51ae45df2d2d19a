"""Names of the input methods of participants, and of their ways to stop the robot."""

from typing import Literal, get_args

InputMethod = Literal[
    "controllers", "hands", "left-hand", "right-hand", "head", "one-switch", "two-switches", "experimenter"
]
METHODS: tuple[InputMethod, ...] = get_args(InputMethod)
StopWay = Literal["buttons", "palm", "gaze", "switch", "experimenter"]
STOP_WAYS: tuple[StopWay, ...] = get_args(StopWay)
