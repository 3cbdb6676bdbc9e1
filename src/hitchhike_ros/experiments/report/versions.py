"""What figures were measured with."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

_WHEELS = ("msgspec", "numpy", "pybullet")


def versions(package: Path) -> dict[str, str]:
    """Of this package, whose folder is given, of what it computes with, and the kind of machine."""
    own = ElementTree.parse(package / "package.xml").findtext("version", "")
    wheels = {name: metadata.version(name) for name in _WHEELS}
    return {"hitchhike_ros": own, "python": platform.python_version(), "machine": platform.machine(), **wheels}
