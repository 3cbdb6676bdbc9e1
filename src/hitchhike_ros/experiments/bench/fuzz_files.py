"""Files that went wrong are read or refused with an error of the package, in bounded time and memory.

Each seed mutates one of the package's maps, worlds, scenarios, parameter files or robots, or makes an image or a scan,
and reads it. Files have at most 1 MB, images that can be read at most 1 M cells.
"""

from __future__ import annotations

import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import NoReturn

import numpy as np

from hitchhike_ros.core.datatypes import CameraInfo, LaserScan, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import RobotLimits, fixed_transforms
from hitchhike_ros.experiments.bench.mutations import mutate, mutate_png
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios import ride_scenario
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import run_all, write_results
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.mapping.laser import check_scan, end_points
from hitchhike_ros.mapping.map_file import load_map, save_map, trinary
from hitchhike_ros.mapping.new_obstacles import MappingParameters
from hitchhike_ros.mapping.sites import load_hitchhiking, load_sites
from hitchhike_ros.modules.obstacle_avoidance import ObstacleAvoidanceParameters
from hitchhike_ros.planning.global_planner import GlobalPlannerParameters
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.servoing.marker_detector import MarkerDetector, MarkerDetectorParameters
from hitchhike_ros.simulation.grid import scenario as grid_scenario
from hitchhike_ros.simulation.physics.camera import silenced
from hitchhike_ros.simulation.world_file import load_world

_SEEDS, _QUICK, _BLOCK = 20_000, 1_000, 250
_MAX_CPU_S, _MAX_MB = 1.0, 200.0
# A case that takes so long, in s of CPU, is given up.
_GIVE_UP_S = 20.0
_PRINTED = 10
_SECTIONS: dict[str, type] = {
    "robot": RobotLimits,
    "localization": LocalizerParameters,
    "mapping": MappingParameters,
    "obstacle_avoidance": ObstacleAvoidanceParameters,
    "global_planner": GlobalPlannerParameters,
    "hitchhiking": HitchhikingParameters,
    "marker_detector": MarkerDetectorParameters,
}


@dataclass(frozen=True)
class Broken:
    """A case that broke a rule: the seed, what it was, and which rule."""

    seed: int
    kind: str
    rule: str


@dataclass(frozen=True)
class BlockResult:
    """So many cases, how many of them could be read, the costs of the dearest ones, and those that broke a rule."""

    cases: int
    read: int
    slowest_s: float
    largest_mb: float
    broken: tuple[Broken, ...]


def run(options: Options, progress: Progress) -> Findings:
    """Every block of seeds is a line of ``fuzz_files.json``; ``--seed`` goes on where another run has ended."""
    seeds = options.seeds or (_QUICK if options.quick else _SEEDS)
    blocks = [
        range(first, min(first + _BLOCK, options.seed + seeds))
        for first in range(options.seed, options.seed + seeds, _BLOCK)
    ]
    results = run_all("files", partial(fuzz_block, options.package), blocks, progress)
    options.output.mkdir(parents=True, exist_ok=True)
    write_results(options.output / "fuzz_files.json", {"files": results})
    broken = [case for result in results for case in result.broken]
    for case in broken[:_PRINTED]:
        again = f"rosrun hitchhike_ros bench fuzz files --seed {case.seed} --seeds 1"
        print(f"{case.kind}: {case.rule}\nagain: {again}\n", file=sys.stderr, flush=True)
    read = sum(result.read for result in results)
    return Findings(
        [
            Figure("files: cases", seeds, "count"),
            Figure("files: cases that can be read", read, "count"),
            Figure("files: cases that broke a rule", len(broken), "count", 0),
            Figure("files: slowest case", max(result.slowest_s for result in results), "s", _MAX_CPU_S),
            Figure("files: largest case", max(result.largest_mb for result in results), "MB", _MAX_MB),
        ]
    )


def fuzz_block(package: Path, seeds: range) -> BlockResult:
    """The cases of some seeds, of files of the package in the folder ``package``."""
    read, slowest_s, largest_mb, broken = 0, 0.0, 0.0, []
    with tempfile.TemporaryDirectory() as folder, silenced():  # libpng says a line for each fault
        cases = _Cases(package, Path(folder))
        for seed in seeds:
            kind, case = cases.case(seed)
            before_mb, started = _restart_peak(), time.process_time()
            try:
                with _given_up():
                    case()
                read += 1
            except HitchhikeError as exc:
                if "\n" in str(exc):
                    broken.append(Broken(seed, kind, f"an error of more than one line: {exc}"))
            except Exception as exc:  # noqa: BLE001  (that there is none is what is measured)
                broken.append(Broken(seed, kind, f"{type(exc).__name__}: {exc}"[:500]))
            cpu_s, mb = time.process_time() - started, _memory_mb("VmHWM") - before_mb
            slowest_s, largest_mb = max(slowest_s, cpu_s), max(largest_mb, mb)
            if cpu_s > _MAX_CPU_S or mb > _MAX_MB:
                broken.append(Broken(seed, kind, f"{cpu_s:.2f} s of CPU, {mb:.0f} MB"))
    return BlockResult(len(seeds), read, slowest_s, largest_mb, tuple(broken))


class _Cases:
    """Makes the case of a seed: writes a file, and says how it is read."""

    def __init__(self, package: Path, folder: Path) -> None:
        self._folder = folder
        for file in (package / "maps").iterdir():
            shutil.copy(file, folder / file.name)
        grid = trinary(load_map(package / "maps" / "corners.yaml"))
        save_map(grid, folder / "small.yaml")
        files = {
            "map": [*(folder.glob("*.yaml"))],
            "world": list(folder.glob("*.world.yaml")),
            "grid scenario": list(folder.glob("*.scenario.yaml")),
            "ride scenario": list((package / "config" / "experiments").glob("*.yaml")),
            "parameters": list((package / "config").glob("*.yaml")),
            "urdf": list((package / "urdf").glob("*.urdf")),
            "image": [folder / "small.pgm", folder / "corners.png", folder / "p18_grid.png"],
        }
        files["map"] = [path for path in files["map"] if path.name.count(".") == 1]
        self._originals = {kind: [path.read_bytes() for path in sorted(paths)] for kind, paths in files.items()}
        height, width = grid.data.shape
        pixels = bytes(height * width)
        self._originals["image"] += [
            b"P%d\n# made\n%d %d\n%s" % (kind, width, height, body)
            for kind, body in (
                (1, b"0 1 " * (height * width // 2)), (2, b"100\n" + b"7 " * height * width), (4, bytes(height * 99)),
                (5, b"65535\n" + pixels * 2), (6, b"255\n" + pixels * 3), (3, b"255\n" + b"1 2 3 " * height * width),
            )
        ]  # fmt: skip
        self._readers: dict[str, Callable[[Path], object]] = {
            "map": load_map,
            "world": _read_world,
            "grid scenario": grid_scenario.load_scenario,
            "ride scenario": ride_scenario.load_scenario,
            "parameters": _read_parameters,
            "urdf": fixed_transforms,
            "image": self._read_image,
            "made image": self._read_image,
        }
        self._sensors: dict[str, Callable[[np.random.Generator], object]] = {
            "scan": _read_scan, "odometry": _read_odometry, "camera info": partial(_read_camera_info, MarkerDetector())
        }  # fmt: skip
        self._kinds = (*self._readers, *self._sensors)

    def case(self, seed: int) -> tuple[str, Callable[[], object]]:
        """What the case is, and what reads it."""
        rng = np.random.default_rng(seed)
        kind = self._kinds[seed % len(self._kinds)]
        if kind in self._sensors:
            return kind, partial(self._sensors[kind], rng)
        if kind == "made image":
            data = mutate_png(rng)
        else:
            originals = self._originals[kind]
            everything = originals if rng.random() < 0.7 else [each for of in self._originals.values() for each in of]
            data = mutate(originals[rng.integers(len(originals))], everything, rng)
        path = self._folder / ("fuzzed.urdf" if kind == "urdf" else "fuzzed.yaml")
        path = self._folder / "fuzzed.pgm" if "image" in kind else path
        path.write_bytes(data)
        return kind, partial(self._readers[kind], path)

    def _read_image(self, image: Path) -> object:
        mode = ("trinary", "scale", "raw")[image.stat().st_size % 3]
        description = self._folder / "fuzzed_image.yaml"
        description.write_text(
            f"image: {image.name}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
            f"occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: {mode}\n"
        )
        return load_map(description)


def _read_world(path: Path) -> object:
    load_world(path)
    return load_sites(path), load_hitchhiking(path, "p3dx")


def _read_parameters(path: Path) -> object:
    return [load_parameters(cls, section, path) for section, cls in _SECTIONS.items()]


# What sensors may say: numbers that are none, that are beyond any sensor's, and sound ones.
_STRANGE = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-320, 1e38, -1e38, 1e300, 5.0, 2.0**31, 2.0**63])


def _numbers(rng: np.random.Generator, count: int, strange: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    sound = rng.uniform(-3.0, 3.0, count)
    return np.where(rng.random(count) < strange, rng.choice(_STRANGE, count), sound)


def _read_scan(rng: np.random.Generator) -> object:
    beams = int(rng.choice([0, 1, 2, 361, 769, 20_000]))
    with np.errstate(all="ignore"):
        stamp, angle, step, nearest, farthest = _numbers(rng, 5, 0.1).tolist()
        ranges = _numbers(rng, beams, rng.random()).astype(np.float32)
        scan = LaserScan(stamp, angle, step, nearest, farthest, ranges)
    check_scan(scan)
    return end_points(scan, Pose2D(*_numbers(rng, 3, 0.0).tolist()))


def _read_odometry(rng: np.random.Generator) -> object:
    track, stamp = PoseBuffer(), 0.0
    for _ in range(20):
        stamp += float(_numbers(rng, 1, 0.1)[0]) if rng.random() < 0.2 else 0.05
        x, y, theta, v, omega = _numbers(rng, 5, 0.05).tolist()
        track.add(Odometry(stamp, Pose2D(x, y, theta), Twist2D(v, omega)))
    return track.at(stamp)


def _read_camera_info(detector: MarkerDetector, rng: np.random.Generator) -> object:
    width, height = (int(size) for size in rng.choice([0, 1, 8, 48, 64], 2))
    K = np.array([[50.0, 0.0, width / 2], [0.0, 50.0, height / 2], [0.0, 0.0, 1.0]])
    K += np.where(rng.random((3, 3)) < 0.2, 20.0 * _numbers(rng, 9, 0.3).reshape(3, 3), 0.0)
    D = _numbers(rng, int(rng.choice([0, 4, 5, 8, 12, 3])), 0.1)
    return detector.detect(np.zeros((height, width), np.uint8), CameraInfo(width, height, K, D))


def _memory_mb(field: str) -> float:
    text = Path("/proc/self/status").read_text(encoding="ascii")
    match = re.search(rf"{field}:\s+(\d+) kB", text)
    return int(match.group(1)) / 1024.0 if match else 0.0


def _restart_peak() -> float:
    """Let the kernel count the largest memory anew, and say how much there is, in MB."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return _memory_mb("VmRSS")


@contextmanager
def _given_up() -> Iterator[None]:
    """Raises TimeoutError within, when it takes too much CPU."""

    def give_up(_signal: int, _frame: FrameType | None) -> NoReturn:
        raise TimeoutError(f"not read after {_GIVE_UP_S:g} s of CPU")

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, _GIVE_UP_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
