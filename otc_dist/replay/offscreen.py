"""Pictures of a MuJoCo model without a screen, by EGL or OSMesa."""

import math
import os
import subprocess
import sys
from importlib import import_module
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float64

Picture = NDArray[np.uint8]  # (height, width, 3)

_LIBRARIES = ("egl", "osmesa")
_SAMPLES = 4  # a pixel
_AMBIENT = 0.4  # of the light: the models' own leaves the sides that we see dark
_MAXIMUM_GEOMS = 200
_ELEVATION = -6.0  # degrees: a little from above, so that the ground shows where it moves
_MIDDLE = 0.42  # of the height that is seen, above the ground
_FOLLOWED = 1  # the body after the world's


class Offscreen:
    """Renders a model from the side, following its first body; a context manager.

    Args:
        model: it stands on the plane z = 0 and moves along x.
        width, height: of a picture, px.
        seen: height of what is seen where the model is, m.

    Raises:
        UserError: neither EGL nor OSMesa works here.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, seen: float) -> None:
        library = import_module(f"mujoco.{_working_library()}")
        self._model, self._data = model, mujoco.MjData(model)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.offsamples = _SAMPLES
        model.vis.headlight.ambient[:] = _AMBIENT
        self._gl = library.GLContext(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(model, _MAXIMUM_GEOMS)
        # They take most of the time where there is no GPU.
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._options, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._camera.azimuth, self._camera.elevation = 90.0, _ELEVATION
        half = math.radians(model.vis.global_.fovy) / 2
        self._camera.distance = seen / 2 / math.tan(half)
        self._camera.lookat[:] = (0.0, 0.0, _MIDDLE * seen)
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._pixels: Picture = np.empty((height, width, 3), np.uint8)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.free()
        self._gl.free()

    def render(self, positions: Float64) -> Picture:
        """The model with its joints at `positions` (nq,); a fresh array."""
        self._data.qpos[:] = positions
        mujoco.mj_forward(self._model, self._data)
        self._camera.lookat[0] = self._data.xpos[_FOLLOWED, 0]
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._options,
            None,
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self._scene,
        )
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._rectangle, self._context)
        return self._pixels[::-1].copy()  # OpenGL's rows go up


def _working_library() -> str:
    """EGL or OSMesa, or what $MUJOCO_GL asks for.

    Tried in a process of its own: OpenGL's bindings can be bound to one library only once.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    tried = (wanted,) if wanted in _LIBRARIES else _LIBRARIES
    for name in tried:
        probe = f"from mujoco.{name} import GLContext; GLContext(8, 8).make_current()"
        command = [sys.executable, "-c", probe]
        if subprocess.run(command, capture_output=True, check=False).returncode == 0:
            return name
    raise UserError(
        f"robots are rendered off-screen, but {' and '.join(tried)} cannot be used here; install"
        " one (on Debian: apt-get install libegl1 libgl1-mesa-dri, or libosmesa6), or use --html"
    )
