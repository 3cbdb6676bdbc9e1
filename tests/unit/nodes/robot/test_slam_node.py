"""What the node slam reads of the parameter server."""

from __future__ import annotations

import pytest

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.nodes.robot.slam import localization_method


@pytest.mark.parametrize("where", ["~method", "method"])
def test_the_method_is_the_nodes_own_or_the_robots(where: str, ros: FakeRos) -> None:  # noqa: F811
    assert localization_method() == "ekf"
    ros.params[where] = "particle"
    assert localization_method() == "particle"


def test_a_method_that_there_is_not_is_refused(ros: FakeRos) -> None:  # noqa: F811
    ros.params["~method"] = "amcl"
    with pytest.raises(ParameterError, match="~method is 'amcl', expected one of ekf, particle"):
        localization_method()
