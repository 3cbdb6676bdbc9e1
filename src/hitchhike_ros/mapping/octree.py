"""3D maps: OctoMap's octree, filled with depth images, and its .bt files (P17 §7.4).

A .bt file says of each voxel whether it is occupied, free or unknown. The same images, in the same order, give the same
file, byte for byte. Format: https://octomap.github.io, class OcTree, writeBinary.
"""

from __future__ import annotations

import math
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros import _octree
from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, Positive
from hitchhike_ros.core.errors import MapFileError, SensorDataError

# What OctoMap's own reader asks for; comments may follow.
_FIRST_LINE = b"# Octomap OcTree binary file"
_HEADER = re.compile(
    re.escape(_FIRST_LINE) + rb"[^\n]*\n(?:#[^\n]*\n)*id OcTree\nsize (\d{1,12})\nres ([-+.0-9eE]{1,30})\ndata\n"
)


@dataclass(frozen=True)
class OctreeParameters:
    """Section ``octree``; all chosen.

    Only every ``stride``-th pixel of a row and a column is used: at 3 m those of a Kinect of 320 pixels are 4 cm apart
    then. Depth beyond ``max_range_m`` is as noisy as a voxel is wide; the way there is free.
    """

    resolution_m: Annotated[float, msgspec.Meta(ge=0.01, le=1.0)] = 0.05
    max_range_m: Positive = 4.0
    stride: Annotated[int, msgspec.Meta(ge=1, le=100)] = 4


@dataclass(frozen=True, eq=False)
class Voxels:
    """The occupied voxels of a map: centres (N, 3) in its frame and lengths of their sides (N,), m."""

    resolution_m: float
    centres: FloatArray
    sides: FloatArray


class OccupancyOctree:
    """A 3D map that grows with each depth image."""

    def __init__(self, params: OctreeParameters) -> None:
        self.params = params
        self._tree = _octree.Tree(params.resolution_m)

    def __len__(self) -> int:
        """Nodes of the tree, inner ones too."""
        return len(self._tree)

    def insert(self, depth: npt.NDArray[np.float32], info: CameraInfo, T_map_optical: FloatArray) -> int:
        """Take a depth image (H, W) in m, NaN where there is no depth, seen from a pose (4, 4).

        Returns:
            How many points it gave.

        Raises:
            SensorDataError: the image has another size than its calibration says, or the pose is senseless.
        """
        if not np.isfinite(T_map_optical).all():
            raise SensorDataError(f"the camera's pose is not finite: {T_map_optical.tolist()}")
        points = depth_points(depth, info, self.params.stride)
        in_map = points @ T_map_optical[:3, :3].T + T_map_optical[:3, 3]
        try:
            self._tree.insert(np.ascontiguousarray(in_map), T_map_optical[:3, 3].copy(), self.params.max_range_m)
        except ValueError as exc:
            raise SensorDataError(f"depth image from {T_map_optical[:3, 3].tolist()}: {exc}") from exc
        return len(points)

    def file(self) -> bytes:
        """The .bt file of the tree as it is now."""
        return self._tree.binary()


def depth_points(depth: npt.NDArray[np.float32], info: CameraInfo, stride: int = 1) -> FloatArray:
    """Points (N, 3) in m in the optical frame (z forward, x right, y down) of the pixels that have a depth > 0.

    ``depth`` (H, W) is along the axis, of a rectified image, as openni's depth/image_raw is but for millimetres:
    x = (u - cx) z / fx, y = (v - cy) z / fy.

    Raises:
        SensorDataError: image and calibration differ in size, or the calibration is senseless.
    """
    if depth.shape != (info.height, info.width):
        raise SensorDataError(f"depth image has shape {depth.shape}, expected {(info.height, info.width)}")
    fx, fy, cx, cy = (float(info.K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not (np.isfinite(info.K).all() and fx > 0.0 and fy > 0.0):
        raise SensorDataError(f"calibration of the depth camera is {info.K.tolist()}, expected fx and fy > 0")
    offset = stride // 2  # the middle of each square of pixels
    z = depth[offset::stride, offset::stride].astype(float)
    v, u = np.indices(z.shape) * stride + offset
    seen = np.isfinite(z) & (z > 0.0)
    z, u, v = z[seen], u[seen], v[seen]
    return np.column_stack(((u - cx) * z / fx, (v - cy) * z / fy, z))


def read_voxels(content: bytes, name: object = "octree") -> Voxels:
    """The occupied voxels of a .bt file; it is checked to its last byte, so that any reader can have it.

    Raises:
        MapFileError: it is no whole .bt file; it names ``name`` and what was expected.
    """
    header = _HEADER.match(content)
    if header is None:
        raise MapFileError(name, "", bytes(content[:60]), f"a file that begins with {_FIRST_LINE.decode()!r}, id, size")
    size = int(header[1])
    try:
        resolution = float(header[2])
    except ValueError:
        resolution = math.nan
    if not 1e-4 <= resolution <= 1e3:
        raise MapFileError(name, "res", header[2].decode(), "metres a voxel is wide")
    data = content[header.end() :]
    if size == 0:
        nodes, occupied = 0, np.empty((0, 4))
        if data:
            raise MapFileError(name, "size", 0, f"the number of nodes, as {len(data)} bytes of them follow")
    else:
        try:
            nodes, occupied = _octree.leaves(data, resolution)
        except ValueError as exc:
            raise MapFileError(name, "data", f"{len(data)} bytes", f"a tree, but it {exc}") from exc
    if nodes != size:
        raise MapFileError(name, "size", size, f"{nodes}, as many nodes as follow")
    return Voxels(resolution, occupied[:, :3], occupied[:, 3])


def save(content: bytes, path: Path | str) -> Voxels:
    """Write a .bt file, whole or not at all, and return what it holds.

    Raises:
        MapFileError: it is no .bt file, or cannot be written.
    """
    voxels, path = read_voxels(content, path), Path(path)
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            try:
                file.write(content)
                file.flush()
                os.fchmod(file.fileno(), 0o644)
                os.replace(file.name, path)
            except OSError:
                os.unlink(file.name)
                raise
    except OSError as exc:
        raise MapFileError(path, "", exc.strerror, "a file that can be written") from exc
    return voxels
