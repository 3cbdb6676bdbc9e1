"""Simulated cameras: pinhole images and depth, rendered by EGL where it loads and by TinyRenderer where not."""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import pybullet as p

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, Positive

Renderer = Literal["auto", "egl", "tiny"]

# The clipping planes of the renderer in m: a robot that touches a wall is no nearer, nothing in a building is farther.
# The near one sets the resolution of depth, z² / near / 2^16 (EGL gives 16 bits): 2 mm at 4 m.
_NEAR_M, _FAR_M = 0.12, 60.0


@dataclass(frozen=True)
class CameraParameters:
    """Section ``simulated_camera``: an ideal pinhole camera."""

    width: int = 640
    height: int = 480
    horizontal_fov_deg: Positive = 60.0

    @property
    def info(self) -> CameraInfo:
        """Calibration. Pixel centres have integer coordinates (as in OpenCV), so the axis is at (width - 1) / 2."""
        f = self.width / 2.0 / math.tan(math.radians(self.horizontal_fov_deg) / 2.0)
        K = np.array([[f, 0.0, (self.width - 1) / 2.0], [0.0, f, (self.height - 1) / 2.0], [0.0, 0.0, 1.0]])
        return CameraInfo(self.width, self.height, K)


@dataclass(frozen=True)
class DepthCameraParameters(CameraParameters):
    """Section ``simulated_depth_camera``: Kinect. Noise grows with the square of the depth; limits and noise chosen."""

    width: int = 320
    height: int = 240
    horizontal_fov_deg: Positive = 58.0
    depth_min_m: Positive = 0.5
    depth_max_m: Positive = 5.0
    sigma_at_1m_m: Positive = 0.0015


class Camera:
    """Renders one robot's view of the world of one pybullet client."""

    def __init__(self, params: CameraParameters, renderer: int) -> None:
        self.info = params.info
        self._renderer, self._flags = renderer, int(p.ER_NO_SEGMENTATION_MASK)
        if renderer == p.ER_BULLET_HARDWARE_OPENGL:
            # The only mode in which this renderer leaves out its shadow map, two thirds of the cost. What it projects
            # are the textures of bodies, and there are none.
            self._flags |= int(p.ER_USE_PROJECTIVE_TEXTURE)
        # TinyRenderer samples a pixel at its corner: this moves its picture by the half pixel that is missing.
        corner = 1.0 if renderer == p.ER_TINY_RENDERER else 0.0
        f = self.info.K[0, 0]
        near, far = _NEAR_M, _FAR_M
        self._projection = np.array(
            [
                [2.0 * f / params.width, 0.0, corner / params.width, 0.0],
                [0.0, 2.0 * f / params.height, corner / params.height, 0.0],
                [0.0, 0.0, -(far + near) / (far - near), -2.0 * far * near / (far - near)],
                [0.0, 0.0, -1.0, 0.0],
            ]
        ).T.ravel().tolist()  # fmt: skip

    def rgb(self, client: int, T_world_optical: FloatArray) -> npt.NDArray[np.uint8]:
        """Colour image (H, W, 3) seen from T_world_optical (4, 4)."""
        rgba, _ = self._render(client, T_world_optical)
        return np.ascontiguousarray(rgba[:, :, :3])

    def depth(self, client: int, T_world_optical: FloatArray) -> npt.NDArray[np.float32]:
        """True depth (H, W) in m along the optical axis."""
        _, buffer = self._render(client, T_world_optical)
        return np.asarray(_FAR_M * _NEAR_M / (_FAR_M - (_FAR_M - _NEAR_M) * buffer), dtype=np.float32)

    def _render(self, client: int, T_world_optical: FloatArray) -> tuple[npt.NDArray[np.uint8], FloatArray]:
        # OpenGL's camera looks along -z with y up, the optical frame along z with y down (REP 103).
        T_gl_world = np.linalg.inv(T_world_optical @ np.diag([1.0, -1.0, -1.0, 1.0]))
        view = T_gl_world.T.ravel().tolist()
        _, _, rgba, depth, _ = p.getCameraImage(
            self.info.width,
            self.info.height,
            view,
            self._projection,
            lightDirection=[-0.5, -0.3, 1.0],
            lightAmbientCoeff=0.65,
            lightDiffuseCoeff=0.4,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._renderer,
            flags=self._flags,
            projectiveTextureView=view,
            projectiveTextureProj=self._projection,
            physicsClientId=client,
        )
        shape = (self.info.height, self.info.width)
        return np.reshape(rgba, (*shape, 4)).astype(np.uint8, copy=False), np.reshape(depth, shape)


class DepthCamera(Camera):
    """A depth camera with its own noise stream."""

    def __init__(self, params: DepthCameraParameters, renderer: int, rng: np.random.Generator) -> None:
        super().__init__(params, renderer)
        self._params, self._rng = params, rng

    def measured_depth(self, client: int, T_world_optical: FloatArray) -> npt.NDArray[np.float32]:
        """Depth (H, W) in m with noise; NaN outside the camera's limits (REP 118)."""
        params = self._params
        depth = self.depth(client, T_world_optical)
        noise = self._rng.standard_normal(depth.shape, dtype=np.float32)
        measured = depth + np.float32(params.sigma_at_1m_m) * depth * depth * noise
        measured[(measured < params.depth_min_m) | (measured > params.depth_max_m)] = np.nan
        return measured


def load_renderer(client: int, wanted: Renderer) -> int:
    """Prepare a fresh ``client``, before any body is in it, and return the renderer to name in requests."""
    plugin = _egl_plugin()
    if wanted == "tiny" or plugin is None or (wanted == "auto" and not egl_works()):
        return int(p.ER_TINY_RENDERER)
    with silenced():
        p.loadPlugin(plugin, "_eglRendererPlugin", physicsClientId=client)
        # The first picture is slow and makes the driver talk.
        flags = p.ER_USE_PROJECTIVE_TEXTURE
        p.getCameraImage(8, 8, renderer=p.ER_BULLET_HARDWARE_OPENGL, flags=flags, physicsClientId=client)
    return int(p.ER_BULLET_HARDWARE_OPENGL)


@functools.cache
def egl_works() -> bool:
    """Whether the EGL plugin renders here. Tried in a process of its own, since it ends the process when it cannot."""
    plugin = _egl_plugin()
    if plugin is None:
        return False
    trial = (
        "import pybullet as p\n"
        "c = p.connect(p.DIRECT)\n"
        f"assert p.loadPlugin({plugin!r}, '_eglRendererPlugin', physicsClientId=c) >= 0\n"
        "p.getCameraImage(8, 8, renderer=p.ER_BULLET_HARDWARE_OPENGL, physicsClientId=c)\n"
        "print('rendered')\n"
    )
    try:
        result = subprocess.run([sys.executable, "-c", trial], capture_output=True, timeout=60.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return result.returncode == 0 and b"rendered" in result.stdout


def _egl_plugin() -> str | None:
    spec = importlib.util.find_spec("eglRenderer")
    return spec.origin if spec is not None else None


@contextmanager
def silenced() -> Iterator[None]:
    """Send what C code prints to nowhere: the graphics driver's chatter would spoil the console."""
    flush = ctypes.CDLL(None).fflush  # of C's own buffers
    sys.stdout.flush()
    flush(None)
    saved = os.dup(1), os.dup(2)
    try:
        with open(os.devnull, "wb") as sink:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        flush(None)
        for target, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, target)
            os.close(copy)
