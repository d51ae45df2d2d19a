"""Render pictures of environments in the middle of an episode.

The oracle controls the robot, and the VR client renders the scene.

    python scripts/figures/pictures.py docs/pictures [ENVIRONMENT_ID…]

The script needs the built client and Chromium. It gets the client's renderer from the event ``observe`` of three.js's
developer tools and renders with its own camera.
"""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from playwright.sync_api import Page, sync_playwright

from avrgym.geometry import transforms
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.constants import PACKAGED_ENVIRONMENTS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.live_world.scene_message import encode_world_poses, make_scene_message
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.real_time_loop import MessageSender, ReceivedMessage

MOMENTS = {
    "Feeding": (3, 11),
    "Drinking": (3, 11),
    "ScratchItch": (6, 36),
    "BedBathing": (3, 90),
    "Dressing": (3, 34),
    "ArmManipulation": (3, 45),
}
"""Seed of the episode and control step of the picture, for each task. Other tasks use ``MOMENT``."""
MOMENT = (3, 11)
SIZE_PX = {"width": 900, "height": 600}
PATIENCE_MS = 600_000
QUALITY = 82


@dataclass(frozen=True)
class Camera:
    """A camera in the world frame: position and target in metres, upward direction and vertical angle of view."""

    eye: list[float]
    at: list[float]
    up: list[float]
    angle_deg: float
    inside: bool


def _numbers(vector: ArrayLike) -> list[float]:
    return np.asarray(vector, float).tolist()


def beside(eye: ArrayLike, at: ArrayLike) -> Camera:
    """Return the camera of a bystander beside the scene."""
    return Camera(_numbers(eye), _numbers(at), [0.0, 0.0, 1.0], 42.0, inside=False)


BYSTANDERS = {
    ("Feeding", "Jaco"): beside((0.75, -1.55, 1.45), (-0.05, -0.20, 0.92)),
    ("Drinking", "Jaco"): beside((0.75, -1.75, 1.45), (-0.08, -0.10, 0.82)),
    ("ScratchItch", "Jaco"): beside((-0.75, -1.85, 1.45), (-0.15, -0.10, 0.80)),
    ("BedBathing", "Jaco"): beside((-1.05, -1.95, 1.75), (-0.20, -0.10, 0.78)),
    ("ArmManipulation", "Jaco"): beside((-1.25, -1.75, 1.45), (-0.25, -0.10, 0.80)),
    ("Feeding", "PR2"): beside((0.85, -1.95, 1.55), (-0.25, -0.25, 0.85)),
    ("Drinking", "PR2"): beside((0.85, -2.00, 1.50), (-0.25, -0.15, 0.80)),
    ("ScratchItch", "PR2"): beside((0.35, -2.25, 1.55), (-0.30, -0.15, 0.82)),
    ("ArmManipulation", "PR2"): beside((0.35, -2.25, 1.55), (-0.30, -0.15, 0.82)),
    ("BedBathing", "PR2"): beside((0.75, -2.15, 1.85), (-0.30, -0.15, 0.80)),
}


def bystander(task: str, robot: str) -> Camera:
    """Return the bystander's camera of an environment, by default the camera of its task."""
    if (task, robot) in BYSTANDERS:
        return BYSTANDERS[task, robot]
    view = TASKS[task].camera_views.select_view(TASKS[task].make_scene(ROBOTS[robot]).mount)
    return beside(view.camera_pos_w, view.target_pos_w)


OWN_CAMERA = """
window.__THREE_DEVTOOLS__ = new EventTarget();
window.__THREE_DEVTOOLS__.addEventListener("observe", ({ detail: renderer }) => {
  if (!renderer.setAnimationLoop) return;
  const render = renderer.render.bind(renderer);
  renderer.render = (scene, camera) => {
    const wanted = window.wantedView;
    const root = scene.children.find((child) => child.rotation.x !== 0 && child.children.length > 1);
    if (!wanted || !root) return render(scene, camera);
    const own = (window.ownCamera ??= camera.clone());
    const inScene = (place) => root.localToWorld(own.position.clone().fromArray(place));
    own.clearViewOffset();
    Object.assign(own, { fov: wanted.angle_deg, aspect: innerWidth / innerHeight, near: 0.02 });
    own.up.copy(inScene(wanted.up).sub(inScene([0, 0, 0])));
    own.position.copy(inScene(wanted.eye));
    own.lookAt(inScene(wanted.at));
    own.updateProjectionMatrix();
    own.updateMatrixWorld();
    scene.traverse(({ userData, material }) => {
      if (userData.skin_of === "person/head") material.colorWrite = material.depthWrite = !wanted.inside;
    });
    render(scene, own);
    const dressed = [];
    scene.traverse((node) => node.isSkinnedMesh && dressed.push(node));
    if (dressed.length > 0) window.shownViews = (window.shownViews ?? 0) + 1;
  };
});
"""


HIDE_CONTROLS = """
document.querySelectorAll("body > :not(#view)").forEach(({ style }) => { style.visibility = "hidden"; })
"""
"""The page's content security policy rejects a style sheet for screenshots."""


class Moment:
    """A session that stays at one control step of an episode."""

    at_rest = True

    def __init__(self, environment_id: str, send: MessageSender) -> None:
        self._send = send
        self._episodes = Episodes(environment_id, 1, people="revised", num_threads=1)
        seed, steps = MOMENTS.get(self._episodes.task.name, MOMENT)
        self._episodes.reset(np.array([0]), [np.random.default_rng(seed)])
        act = self._episodes.task.expert(self._episodes)
        for _ in range(steps):
            self._episodes.step(act(self._episodes.observe()))
        self.scenes = [(environment_id, self._episodes.get_person(0))]
        self._poses = encode_world_poses(self._episodes)
        self._ticks = 0

    def send_initial_state(self, send: MessageSender, role: messages.Role, now_s: float) -> None:
        """Send the scene to the client."""
        name = self._episodes.environment_id
        send(messages.Welcome(messages.PROTOCOL_VERSION, name, role, haptics=False, sounds=False))
        send(self._scene())

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        """Ignore the client's messages."""

    def tick(self, now_s: float) -> None:
        """Send the same state again."""
        self._ticks += 1
        self._send(messages.WorldState(self._ticks, self._ticks * TICK_S, -1, b"", [], self._poses))

    def close(self, now_s: float) -> None:
        """Do nothing, because the session stores no data."""

    def glance(self) -> Camera:
        """Return the camera of a participant who looks at the robot's tool."""
        scene = self._scene()
        pose = dict(
            zip(scene.bodies, np.frombuffer(self._poses, "<f4").reshape(-1, 7).astype(float), strict=False)
        )
        head, tool = pose[scene.head_bodies[0]], pose[SCENE_TOOL_BODY]
        eye = head[:3] + transforms.rotate(head[3:], scene.eyes)
        upwards = transforms.rotate(head[3:], [0.0, 0.0, 1.0])
        return Camera(_numbers(eye), _numbers(tool[:3]), _numbers(upwards), 70.0, inside=True)

    def _scene(self) -> messages.Scene:
        return make_scene_message(0, self._episodes, Registration(np.zeros(3), 0.0))


def take(page: Page, camera: Camera, file: Path) -> None:
    """Save a camera's picture after the client has rendered two frames."""
    page.evaluate("view => { window.wantedView = view; window.shownViews = 0; }", asdict(camera))
    page.wait_for_function("() => window.shownViews > 2", timeout=PATIENCE_MS)
    page.screenshot(path=file, type="jpeg", quality=QUALITY, timeout=PATIENCE_MS)
    print(file)


def main() -> None:
    """Write a bystander's and a participant's picture of each environment on the command line, by default of all."""
    folder, wanted = Path(sys.argv[1]), sys.argv[2:] or list(PACKAGED_ENVIRONMENTS)
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        for environment_id in wanted:
            task, robot = find_environment(environment_id)
            name = "".join(f"_{c.lower()}" if c.isupper() else c for c in task).lstrip("_")
            stem = f"{name}_{robot.lower()}"
            with LiveServer(lambda send, shown=environment_id: Moment(shown, send), "127.0.0.1", 0) as server:
                page = chromium.new_page(viewport=SIZE_PX)  # type: ignore[arg-type]
                page.add_init_script(OWN_CAMERA)
                page.goto(server.participant_url, timeout=PATIENCE_MS)
                page.evaluate(HIDE_CONTROLS)
                take(page, bystander(task, robot), folder / f"{stem}.jpg")
                take(page, server.session.glance(), folder / f"{stem}_inside.jpg")
                page.close()
        chromium.close()


if __name__ == "__main__":
    main()
