"""Check the graphics card and rendering."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from avrgym.doctor.finding import Finding, make_error_finding, make_ok_finding, make_warning_finding
from avrgym.system.mujoco_setup import RENDERING_HINT

PROCESS_TIMEOUT_S = 60.0
TEST_SCENE_XML = (
    """<mujoco><worldbody><light pos="0 0 3"/><geom size="0.3" rgba="1 0 0 1"/></worldbody></mujoco>"""
)
TEST_IMAGE_HEIGHT_PX, TEST_IMAGE_WIDTH_PX = 48, 64
DRM_DEVICE_FOLDER = Path("/sys/class/drm")
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast")
"""Names of software renderers of Mesa. With them, rendering is slow."""


def check_graphics_card() -> Finding:
    """Check the graphics card: its name, and whether the driver of an NVIDIA card responds."""
    program = shutil.which("nvidia-smi")
    if program is not None:
        return _nvidia(program)
    drivers = {(device / "device" / "driver").resolve().name for device in DRM_DEVICE_FOLDER.glob("renderD*")}
    if drivers:
        return make_ok_finding(f"one with the kernel driver {', '.join(sorted(drivers))}")
    return make_ok_finding("none found; the processor renders, which is sufficient")


def _nvidia(program: str) -> Finding:
    asked = [program, "--query-gpu=name,driver_version", "--format=csv,noheader"]
    ran = subprocess.run(asked, capture_output=True, text=True, timeout=PROCESS_TIMEOUT_S, check=False)
    lines = (ran.stdout or ran.stderr).strip().splitlines() or ["no answer"]
    if ran.returncode == 0:
        return make_ok_finding("; ".join(f"{line.replace(', ', ', driver ')}" for line in lines))
    return make_warning_finding(
        f"NVIDIA's driver does not respond: {lines[0]}",
        "restart the computer after an update of driver or kernel, or reinstall the driver",
    )


def check_rendering() -> Finding:
    """Check whether MuJoCo can render an image. The finding contains the renderer's name."""
    command = [sys.executable, "-m", "avrgym.doctor.graphics"]
    try:
        ran = subprocess.run(command, capture_output=True, text=True, timeout=PROCESS_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return make_error_finding(f"no image was rendered within {PROCESS_TIMEOUT_S:.0f} s", RENDERING_HINT)
    way = f"MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}"
    if ran.returncode != 0:
        return make_error_finding(f"no image can be rendered with {way}: {_reason(ran)}", RENDERING_HINT)
    renderer = ran.stdout.strip()
    slowly = ", by the processor" if renderer.startswith(SOFTWARE_RENDERERS) else ""
    return make_ok_finding(f"an image was rendered by {renderer} ({way}{slowly})")


def _reason(ran: "subprocess.CompletedProcess[str]") -> str:
    if ran.returncode < 0:
        return f"the graphics library ended its process ({signal.strsignal(-ran.returncode)})"
    said = [line for line in ran.stderr.splitlines() if line.strip()]
    return said[-1] if said else "no reason was printed"


def render_test_image() -> str:
    """Render a red ball. Returns the renderer's name. Raises ``RuntimeError`` if the image contains no ball."""
    import mujoco
    from OpenGL import GL

    model = mujoco.MjModel.from_xml_string(TEST_SCENE_XML)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, TEST_IMAGE_HEIGHT_PX, TEST_IMAGE_WIDTH_PX) as renderer:
        renderer.update_scene(data)
        red, green, _ = renderer.render()[TEST_IMAGE_HEIGHT_PX // 2, TEST_IMAGE_WIDTH_PX // 2]
        if red <= green:
            raise RuntimeError("the image does not show the red ball; update the graphics driver")
        return GL.glGetString(GL.GL_RENDERER).decode()


if __name__ == "__main__":  # run in a separate process, because a graphics library may crash it
    print(render_test_image())
