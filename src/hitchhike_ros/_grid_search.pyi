import numpy as np
import numpy.typing as npt

def astar(
    cost: npt.NDArray[np.float32], start: tuple[int, int], goal: tuple[int, int]
) -> tuple[npt.NDArray[np.int64], float, int]: ...
