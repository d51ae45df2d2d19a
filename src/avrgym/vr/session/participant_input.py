"""The participant's input during a session: their input profile, and selections by the experimenter."""

from typing import Any

import msgspec

from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import MessageSender


class ParticipantInput:
    """The input profile of a participant. It may change during a session."""

    def __init__(self, profile: InputProfile = DEFAULT_INPUT_PROFILE) -> None:
        self.profile = profile
        self._targets = messages.ParticipantTargets(0, [])

    def send_initial_state(self, send: MessageSender, role: messages.Role) -> None:
        """Send the profile to a new client, and the targets to an experimenter."""
        send(self.make_profile_message())
        if role == "experimenter" and self.profile.method == "experimenter":
            send(self._targets)

    def make_profile_message(self) -> messages.InputProfileMessage:
        """Returns the message that contains the profile and the participant's stop methods."""
        values: dict[str, Any] = msgspec.structs.asdict(self.profile)
        values["stops"] = self.profile.stop_inputs
        return messages.InputProfileMessage(**values)

    def relay_selection(
        self, message: messages.OfferedTargets | messages.TargetSelectionRequest, send: MessageSender
    ) -> None:
        """Send the participant's targets to the experimenter, or the experimenter's selection to the participant.

        The experimenter may select only with the input method ``experimenter``. With other methods, the experimenter
        receives an error.
        """
        if isinstance(message, messages.OfferedTargets):
            self._targets = messages.ParticipantTargets(message.offer_number, message.targets)
            send(self._targets)
        elif self.profile.method == "experimenter":
            send(messages.TargetSelected(message.offer_number, message.target_value))
        else:
            problem = (
                f"the participant selects with {self.profile.method}; "
                "to select for them, change the input method to experimenter"
            )
            send(messages.Problem(problem, "experimenter"))
