"""Renders a GLB file with three.js and its model with MuJoCo from one camera.

Surfaces are unlit: only shapes and colours are compared.
"""

import base64
import io
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image
from playwright.sync_api import Page, Route

from avrgym.models.collision_bits import VISUAL_GROUP
from helpers.system.paths import ROOT

WIDTH, HEIGHT = 480, 360
THREE = ROOT / "client" / "node_modules" / "three"
ADDRESS = "http://pictures.test"
_PAGE = """<script type="importmap">
{"imports": {"three": "/build/three.module.js", "three/addons/": "/examples/jsm/"}}
</script>"""
_SCRIPT = """async ([glb, width, height, { position, target, degrees }]) => {
    const three = await import("three");
    const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
    const bytes = Uint8Array.from(atob(glb), (letter) => letter.charCodeAt(0)).buffer;
    const scene = (await new GLTFLoader().parseAsync(bytes, "")).scene;
    for (const node of [...scene.children]) if (node.userData.bodies) node.removeFromParent();
    scene.traverse((node) => {
        if (!node.isMesh) return;
        const { map, transparent, opacity, side } = node.material;
        node.material = new three.MeshBasicMaterial({ map, transparent, opacity, side, vertexColors: true });
        node.frustumCulled = false;
    });
    const camera = new three.PerspectiveCamera(degrees, width / height, 0.01, 30);
    camera.up.set(0, 0, 1);
    camera.position.set(...position);
    camera.lookAt(...target);
    const renderer = new three.WebGLRenderer({ antialias: false, alpha: true, preserveDrawingBuffer: true });
    renderer.setPixelRatio(1);
    renderer.setSize(width, height);
    renderer.setClearColor(0, 0);
    renderer.render(scene, camera);
    const picture = renderer.domElement.toDataURL("image/png");
    renderer.forceContextLoss();
    return picture.split(",")[1];
}"""


class Rendering(NamedTuple):
    """An image (H, W, 3) and the mask (H, W) of its surfaces."""

    colours: np.ndarray
    covered: np.ndarray


def camera_at(
    target: np.ndarray, distance_m: float, azimuth_deg: float, elevation_deg: float
) -> mujoco.MjvCamera:
    """Return a MuJoCo camera that looks at a target."""
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance = target, distance_m
    camera.azimuth, camera.elevation = azimuth_deg, elevation_deg
    return camera


def open_page(page: Page) -> Page:
    """Open a page that can load only three.js and its loader."""

    def answer(route: Route) -> None:
        path = route.request.url.removeprefix(ADDRESS).lstrip("/")
        if path:
            route.fulfill(path=THREE / path, content_type="text/javascript")
        else:
            route.fulfill(body=_PAGE, content_type="text/html")

    page.route(f"{ADDRESS}/**", answer)
    page.goto(f"{ADDRESS}/")
    return page


def render_three(page: Page, glb: bytes, model: mujoco.MjModel, camera: mujoco.MjvCamera) -> Rendering:
    """Render a file with three.js."""
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    ahead = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    seen_from = {
        "position": (camera.lookat - camera.distance * ahead).tolist(),
        "target": camera.lookat.tolist(),
        "degrees": float(model.vis.global_.fovy),
    }
    encoded = page.evaluate(_SCRIPT, [base64.b64encode(glb).decode(), WIDTH, HEIGHT, seen_from])
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGBA")).astype(int)
    return Rendering(pixels[..., :3], pixels[..., 3] > 0)


def render_mujoco(model: mujoco.MjModel, camera: mujoco.MjvCamera, excluded: set[int]) -> Rendering:
    """Render a model with MuJoCo, without the geoms of ``excluded`` bodies."""
    model.vis.headlight.ambient, model.vis.headlight.diffuse, model.vis.headlight.specular = (
        [1] * 3,
        [0] * 3,
        [0] * 3,
    )
    model.vis.quality.offsamples = 0
    for geom in range(model.ngeom):
        if int(model.geom_bodyid[geom]) in excluded:
            model.geom_group[geom] = VISUAL_GROUP + 1
    data, option = mujoco.MjData(model), mujoco.MjvOption()
    mujoco.mj_forward(model, data)
    option.geomgroup[:], option.sitegroup[:] = 0, 0
    option.geomgroup[VISUAL_GROUP] = 1
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            renderer.scene.flags[flag] = 0
        renderer.update_scene(data, camera, option)
        renderer.scene.nlight = min(renderer.scene.nlight, 1)
        colours = renderer.render().astype(int)
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera, option)
        covered = renderer.render()[..., 0] >= 0
    return Rendering(colours, covered)
