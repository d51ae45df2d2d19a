"""Draws one small picture and prints what drew it; run by itself, as a graphics library may end its process."""

import mujoco
from OpenGL import GL

SCENE = """<mujoco><worldbody><light pos="0 0 3"/><geom size="0.3" rgba="1 0 0 1"/></worldbody></mujoco>"""
HEIGHT_PX, WIDTH_PX = 48, 64


def draw() -> str:
    """The name of what drew a red ball; ``RuntimeError`` where the ball is not seen."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, HEIGHT_PX, WIDTH_PX) as renderer:
        renderer.update_scene(data)
        red, green, _ = renderer.render()[HEIGHT_PX // 2, WIDTH_PX // 2]
        if red <= green:
            raise RuntimeError("a red ball was drawn, and the picture does not show it")
        return GL.glGetString(GL.GL_RENDERER).decode()


if __name__ == "__main__":
    print(draw())
