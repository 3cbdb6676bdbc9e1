"""The examples in docstrings are true, where they need no simulated world."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "hitchhike_ros"
ROOMS = ("core", "mapping", "planning", "localization", "control", "servoing", "protocol", "modules")
WITH_EXAMPLES = sorted(
    path for room in ROOMS for path in (PACKAGE / room).rglob("*.py") if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_examples(path: Path) -> None:
    module = importlib.import_module(".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts))
    failed, attempted = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert (failed, attempted > 0) == (0, True)


def test_there_are_examples() -> None:
    assert {path.stem for path in WITH_EXAMPLES} >= {"geometry", "polyline", "pose_buffer"}
