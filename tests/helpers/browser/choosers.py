"""Participants in a browser who select and stop with one input profile."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from avrgym.recording.input_profile import InputProfile
from avrgym.vr.emulation.emulated_headset import EmulatedHeadset
from avrgym.vr.protocol import messages
from avrgym.vr.server.live_server import LiveServer

GUARD_MS = 450.0
"""Time after which a switch selects among new targets, milliseconds; see the client's ``scanner.ts``."""
PATIENCE_S = 5.0
"""Time after which a selection without effect is repeated."""


class ExperimenterClient:
    """An experimenter's connection without a page. ``targets`` are those that the participant can select now."""

    def __init__(self, server: LiveServer) -> None:
        address = server.list_page_urls("watch", server.tokens.experimenter)[0].partition("#")[0]
        self.targets = messages.ParticipantTargets(0, [])
        self._opened = ExitStack()
        self._socket = self._opened.enter_context(connect(address.replace("http", "ws", 1), max_size=None))
        hello = messages.Hello(messages.PROTOCOL_VERSION, server.tokens.experimenter, "test", emulated=True)
        self.send(hello)
        threading.Thread(target=self._receive, daemon=True).start()

    def __enter__(self) -> "ExperimenterClient":
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def send(self, message: messages.Message) -> None:
        self._socket.send(messages.encode_message(message))

    def press(self, value: int) -> bool:
        """Select a target if it is offered. Returns whether it is."""
        offered = self.targets
        if value not in [target.value for target in offered.targets]:
            return False
        self.send(messages.TargetSelectionRequest(offered.offer_number, value))
        return True

    def _receive(self) -> None:
        with suppress(ConnectionClosed):
            self._take_messages()

    def _take_messages(self) -> None:
        states = 0
        for data in self._socket:
            assert isinstance(data, bytes)
            message = messages.decode_server_message(data)
            if isinstance(message, messages.ParticipantTargets):
                self.targets = message
            elif isinstance(message, messages.WorldStateChange):
                states += 1
                if states % messages.STATES_PER_RECEIPT == 0:
                    self.send(messages.StateReceipt(states))


class Chooser:
    """Selects buttons of the panel in VR with the methods of a profile."""

    def __init__(
        self, headset: EmulatedHeadset, profile: InputProfile, experimenter: ExperimenterClient
    ) -> None:
        self._headset, self._profile, self._experimenter = headset, profile, experimenter

    def rest(self, poses: dict[str, Any]) -> dict[str, Any]:
        """Return the poses in which only the arms of the profile are tracked."""
        resting = {arm: None for arm in ("left", "right") if arm not in self._profile.tracked_arms}
        return poses | resting

    def choose(self, value: int, done: Callable[[], bool] | None = None) -> None:
        """Select a button until something is done, by default until another offer replaces it."""
        headset = self._headset
        before = headset.call_emulator("offer")
        done = done or (lambda: headset.call_emulator("offer") != before)
        while not done():
            if value in [button["value"] for button in headset.call_emulator("buttons")]:
                self._try(value)
            discard_attempt = time.monotonic() + PATIENCE_S
            while not done() and time.monotonic() < discard_attempt:
                headset.wait_for_frames(2)

    def _try(self, value: int) -> None:
        headset = self._headset
        match self._profile.method:
            case "head":
                headset.look_at_button(value)
            case "one-switch":
                headset.page.wait_for_function(
                    "([value]) => window.avrgymEmulator.highlighted() === value", arg=[value], polling=20
                )
                headset.page.keyboard.press("a")
            case "two-switches":
                headset.page.wait_for_timeout(GUARD_MS)
                while headset.call_emulator("highlighted") != value:
                    headset.page.keyboard.press("Space")
                headset.page.keyboard.press("Enter")
            case "experimenter":
                self._experimenter.press(value)
            case "left-hand":
                headset.select_answer(value, "left")
            case _:
                headset.select_answer(value)

    def stop(self) -> None:
        """Stop the robot in the profile's own way."""
        headset = self._headset
        match self._profile.stop_inputs[0]:
            case "switch":
                headset.page.keyboard.press("Space")
            case "gaze":
                headset.wait_for_frames(5)
                headset.begin_emergency_stop("gaze")
            case "experimenter":
                self._experimenter.send(messages.ExperimenterCommand("stop"))
            case "palm":
                headset.begin_emergency_stop("palm")
            case _:
                headset.press_menu("left")
