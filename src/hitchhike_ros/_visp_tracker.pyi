"""Types of the compiled module (src/visp_tracker.cpp)."""

import numpy as np
import numpy.typing as npt

from hitchhike_ros.errors import VisionError

class InvalidInputError(VisionError): ...
class VispError(VisionError): ...

def square_poses(corners: npt.NDArray[np.float64], size: float) -> list[tuple[npt.NDArray[np.float64], float]]: ...

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
