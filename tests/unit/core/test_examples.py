"""The examples in the docstrings of core are true."""

from __future__ import annotations

import doctest
from types import ModuleType

import pytest

from hitchhike_ros.core import geometry, polyline, pose_buffer


@pytest.mark.parametrize("module", [geometry, polyline, pose_buffer], ids=lambda module: module.__name__)
def test_examples(module: ModuleType) -> None:
    failed, attempted = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert failed == 0
    assert attempted > 0
