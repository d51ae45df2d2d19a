"""A simulated participant with an emulated headset, on the client's page in headless Chromium.

This tests the logic of client, protocol and session. It does not test the comfort or latency of a headset.
"""

import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from avrgym.vr.emulation.in_process_client import CALIBRATION_STILL_TIME_S
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant
from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose
from avrgym.vr.session.session import Session

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
"""Names of Chromium's executable, in order of preference."""
CHROMIUM_FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-watchdog",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
FRAME_INTERVAL_S = 1.0 / 72.0
"""Interval in seconds at which the simulated participant sets poses."""
_SHOW_CONTROLS = """(visibility) => {
    for (const each of document.querySelectorAll("#card, #emergency")) each.style.visibility = visibility;
}"""
"""Script that hides or shows the controls over the view. The page's security policy forbids style sheets of
Playwright."""
PAGE_TIMEOUT_S = 60.0
"""Timeout of requests to the page, in seconds."""
MAX_PHASE_DURATION_S = 600.0
"""Maximum duration of a session's phase in seconds. It is sufficient for a slow computer."""


class BrowserMissingError(RuntimeError):
    """Raised if Playwright or Chromium is missing. The message contains the command that installs it."""


def find_chromium() -> str | None:
    """Returns the path of the installed Chromium; ``None`` if none is installed. Playwright then uses its own
    Chromium."""
    return next((path for name in CHROMIUM_NAMES if (path := shutil.which(name))), None)


class EmulatedHeadset:
    """The client's page in headless Chromium. This class sets the poses of headset and controllers."""

    def __init__(
        self, url: str, width: int = 640, height: int = 360, query: str = "", script: str = ""
    ) -> None:
        """Open the page in a window that is small enough for a software renderer.

        Args:
            url: the participant's address.
            width: width of the view of both eyes together, pixels.
            height: height of the view, pixels.
            query: further parameters of the URL. ``&detail=full`` draws in full quality. ``&headset=vive`` emulates the
                inputs of that headset; ``emulated-devices.ts`` of the client contains the allowed names.
            script: JavaScript that runs before the scripts of the page.

        Raises:
            BrowserMissingError: if Playwright or Chromium is missing.
        """
        try:
            from playwright.sync_api import Error, sync_playwright
        except ImportError as error:
            raise BrowserMissingError(
                "Playwright is not installed; run `pip install 'avrgym[browser]'`"
            ) from error
        self._playwright = sync_playwright().start()
        try:
            self._browser = self._playwright.chromium.launch(
                executable_path=find_chromium(), args=list(CHROMIUM_FLAGS)
            )
        except Error as error:
            self._playwright.stop()
            raise BrowserMissingError(
                "Chromium is not installed; run `playwright install chromium`"
            ) from error
        self.page = self._browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(1000 * PAGE_TIMEOUT_S)
        if script:
            self.page.add_init_script(script)
        page, mark, token = url.partition("#")
        self.page.goto(f"{page}?emulate=1{query}{mark}{token}")
        self.page.wait_for_function("() => window.avrgymEmulator !== undefined")

    def __enter__(self) -> "EmulatedHeadset":
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.close()
        self._playwright.stop()

    def call_emulator(self, function: str, *arguments: Any) -> Any:
        """Calls a JavaScript function of the page's emulator. Returns its result."""
        return self.page.evaluate(
            "([name, rest]) => window.avrgymEmulator[name](...rest)", [function, list(arguments)]
        )

    def enter_vr(self) -> None:
        """Click Enter VR and wait until the XR session runs."""
        self.page.get_by_role("button", name="Enter VR").click()
        self.page.wait_for_function("() => window.avrgymEmulator.presenting()")

    def set_poses(self, frame: TrackingFrameMessage, *, right: bool = True) -> None:
        """Set the poses of headset and controllers. ``right``: whether the right controller moves too."""
        poses = {"head": _plain(frame.head), "left": _plain(frame.left)}
        self.call_emulator("setPoses", poses | ({"right": _plain(frame.right)} if right else {}))

    def pull_trigger(self, hand: str) -> None:
        """Press and release the trigger of a controller. Each state lasts at least one XR frame."""
        for pressed in (True, False):
            self.call_emulator("setTrigger", hand, pressed)
            self.wait_for_frames(2)

    def press_select(self) -> None:
        """Press and release the select input of this headset. Each state lasts at least two XR frames."""
        for pressed in (True, False):
            self.call_emulator("select", pressed)
            self.wait_for_frames(4)

    def press_menu(self, hand: str) -> None:
        """Press and release the menu button of a controller."""
        for pressed in (True, False):
            self.call_emulator("holdMenu", hand, pressed)
            self.wait_for_frames(2)

    def begin_emergency_stop(self, method: str) -> None:
        """Begin an emergency stop with this stop method. Its input remains active after this call."""
        match method:
            case "button":
                self.call_emulator("holdMenu", "left", True)
            case "triggers":
                self.call_emulator("setTrigger", "left", True)
                self.call_emulator("setTrigger", "right", True)
            case "squeeze":
                self.call_emulator("setSqueeze", "right", True)
            case "select":
                self.call_emulator("select", True)
            case "palm":
                self.call_emulator("raisePalm", "right")
            case _:
                self.call_emulator("lookAt", self.call_emulator("stop")["sign"])

    def wait_for_frames(self, count: int) -> None:
        """Wait until the page has drawn ``count`` more XR frames."""
        drawn = self.call_emulator("framesDrawn")
        self.page.wait_for_function(
            "([drawn]) => window.avrgymEmulator.framesDrawn() >= drawn", arg=[drawn + count]
        )

    def select_answer(self, value: int, hand: str | None = None) -> None:
        """Point at the answer button with this value, and select it.

        ``hand``: the controller that points; by default, the pointer of this headset. The pointer first points next to
        the panel, because a pointer that rests on a button does not select it.
        """
        x, y, z = self._centre_of(value)
        for point in ((x, y + 3.0, z), (x, y, z)):
            if hand is None:
                self.call_emulator("pointAt", point)
            else:
                self.call_emulator("aimAt", hand, point)
            self.wait_for_frames(2)
        if hand is None:
            self.press_select()
        else:
            self.pull_trigger(hand)

    def _centre_of(self, value: int) -> tuple[float, float, float]:
        """Returns the centre (x, y, z) of the button with this value on the panel, in metres in ``local-floor``."""
        return next(
            tuple(button["centre"]) for button in self.call_emulator("buttons") if button["value"] == value
        )

    def look_at_button(self, value: int) -> None:
        """Turn the head away from the panel until no button is highlighted. Then look at the button with this value."""
        x, y, z = self._centre_of(value)
        self.call_emulator("lookAt", (x, y + 3.0, z))
        self.wait_for_frames(3)
        self.page.wait_for_function("() => window.avrgymEmulator.highlighted() === null")
        self.call_emulator("lookAt", (x, y, z))
        self.wait_for_frames(3)

    def save_screenshot(self, path: Path) -> Path:
        """Saves the participant's view of both eyes as an image. Returns its path."""
        self.page.evaluate(_SHOW_CONTROLS, "hidden")
        self.page.screenshot(path=path)
        self.page.evaluate(_SHOW_CONTROLS, "")
        return path


BACK_BUTTON_VALUE, DONE_BUTTON_VALUE, AGAIN_BUTTON_VALUE, CONTINUE_BUTTON_VALUE = -1, -2, -3, -4
"""Values of panel buttons that are not answers; see the client's ``paint-panel.ts``."""
SCREENSHOT_DELAY_S = {"trial": 4.0}
"""Delay in seconds from the start of a phase to the screenshot of the participant's view, by phase."""


class BrowserClient:
    """A simulated participant who takes part in a session in the browser.

    The participant enters VR, holds still during calibration, presses the trigger, moves during trials, and answers the
    questionnaire by pointing.
    """

    def __init__(
        self,
        headset: EmulatedHeadset,
        session: Session,
        participant: SimulatedParticipant,
        pictures: Path,
        log: Callable[[str], None],
        picture_delay_s: Mapping[str, float] = SCREENSHOT_DELAY_S,
    ) -> None:
        """Create a client.

        Args:
            headset: the emulated headset.
            session: the session in which the participant takes part.
            participant: the simulated participant.
            pictures: folder for screenshots of the participant's view.
            log: called with a description of each phase.
            picture_delay_s: delay from the start of a phase to the phase's screenshot, by phase.
        """
        self.screenshots: list[Path] = []
        self._headset, self._session, self._participant = headset, session, participant
        self._folder, self._log, self._picture_after_s = pictures, log, picture_delay_s
        self._phase: tuple[str, int] = ("", 0)
        self._phase_began = self._changed_s = 0.0
        self._asked = ""

    def run(self) -> list[Path]:
        """Takes part until the session is finished. Returns the paths of the screenshots.

        Raises:
            TimeoutError: if a phase of the session lasts more than ten minutes.
        """
        headset, began = self._headset, time.monotonic()
        headset.set_poses(self._participant.make_tracking_frame(0.0, moving=False))
        headset.enter_vr()
        while self._phase[0] != "finished":
            now = time.monotonic() - began
            phase, question = headset.call_emulator("phaseAndQuestion")
            self._notice(phase, now)
            if now - self._changed_s > MAX_PHASE_DURATION_S:
                raise TimeoutError(
                    f"the session has been in phase {self._phase[0]!r} for {MAX_PHASE_DURATION_S:.0f} s, the "
                    f"maximum; read the "
                    "server's messages, then start again"
                )
            self._act(question, now)
            time.sleep(FRAME_INTERVAL_S)
        return self.screenshots

    def _notice(self, phase: dict[str, Any], now_s: float) -> None:
        found: tuple[str, int] = phase["name"], phase["trial"]
        if found != self._phase:
            self._phase, self._phase_began, self._changed_s = found, now_s, now_s
            self._asked = ""
            plan = self._session.plan
            trial = plan.trials[max(found[1] - 1, 0)]
            self._participant.adopt_posture(trial.environment, plan.find_trial_settings(trial))
            self._log(f"{found[0].replace('_', ' ')} (trial {found[1]} of {phase['trials']})")

    def _act(self, question: dict[str, Any] | None, now_s: float) -> None:
        name, _ = self._phase
        frame = self._participant.make_tracking_frame(
            now_s, moving=name != "calibration", watching=name == "trial"
        )
        self._headset.set_poses(frame, right=question is None and name != "confirm")
        self._take_picture(now_s)
        rests = name in ("headset", "calibration", "check", "ready", "paused")
        if rests and now_s - self._phase_began > CALIBRATION_STILL_TIME_S:
            self._headset.pull_trigger("right")
            self._phase_began = now_s
        if name == "headset_stop":
            self._headset.press_menu("right")
        if name == "confirm" and self._asked != name and self._headset.call_emulator("buttons"):
            self._asked = name
            self._headset.select_answer(DONE_BUTTON_VALUE)
        if (
            question is not None
            and question["item"] != self._asked
            and self._headset.call_emulator("buttons")
        ):
            self._asked = question["item"]
            results = self._session.attempt_results
            self._headset.select_answer(
                self._participant.rate_item(question["item"], question["points"], results)
            )

    def _take_picture(self, now_s: float) -> None:
        after_s = self._picture_after_s.get(self._phase[0])
        if (
            after_s is not None
            and now_s - self._phase_began > after_s
            and self._picture not in self.screenshots
        ):
            self.screenshots.append(self._headset.save_screenshot(self._picture))

    @property
    def _picture(self) -> Path:
        """Returns a new path for the screenshot of the current phase."""
        name, trial = self._phase
        return self._folder / f"trial-{trial:02}-{name}.png"


def _plain(pose: XRPose | None) -> dict[str, Any] | None:
    return None if pose is None else {"position": pose.position, "orientation": pose.orientation}
