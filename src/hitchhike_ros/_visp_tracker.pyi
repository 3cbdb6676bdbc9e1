"""Types of the compiled module (src/visp_tracker.cpp)."""

import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.errors import VisionError

class InvalidInputError(VisionError): ...
class VispError(VisionError): ...

def check_image(image: npt.NDArray[np.uint8]) -> None: ...
def fit_square(
    image: npt.NDArray[np.uint8], corners: npt.NDArray[np.float64], reach: float, final_reach: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None: ...
def pattern(image: npt.NDArray[np.uint8], corners: npt.NDArray[np.float64], cells: int) -> FloatArray: ...
def whitening(covariance: FloatArray) -> FloatArray: ...
def project_corners(T_camera_marker: FloatArray, size: float) -> FloatArray: ...
def corner_jacobian(T_camera_marker: FloatArray, size: float) -> FloatArray: ...
def solve(points: FloatArray, whitening: FloatArray, size: float) -> list[tuple[FloatArray, FloatArray, float]]: ...
def square_on_poses(
    points: FloatArray,
    whitening: FloatArray,
    size: float,
    start: FloatArray,
    T_base_camera: FloatArray,
    upright_sigma: float,
    flat: float,
) -> list[tuple[FloatArray, FloatArray, float]]: ...

class TagDetector:
    def __init__(
        self,
        family: str = "36h11",
        *,
        quad_decimate: float = 1.0,
        threads: int = 1,
        refine_edges: bool = True,
        decode_sharpening: float = 0.25,
    ) -> None: ...
    def detect(self, image: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]: ...

class ModelTracker:
    def __init__(
        self,
        *,
        edges: bool = True,
        keypoints: bool = True,
        edge_range_px: int = 8,
        edge_step_px: float = 3.0,
        edge_threshold: float = 5000.0,
        max_keypoints: int = 60,
    ) -> None: ...
    def start(
        self,
        image: npt.NDArray[np.uint8],
        intrinsics: tuple[float, float, float, float],
        T_camera_tag: npt.NDArray[np.float64],
        size: float,
    ) -> None: ...
    def track(self, image: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.float64], float, int, int] | None: ...
