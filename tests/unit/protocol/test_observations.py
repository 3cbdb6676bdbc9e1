"""What servoing tells the other modules of an image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.observations import Observations, decode_observations, encode_observations

NUMBERS = st.floats(-50.0, 50.0)


@given(
    st.lists(st.tuples(st.integers(0, 30), NUMBERS, NUMBERS, NUMBERS), max_size=4), st.sampled_from(["", "coasting"])
)
def test_what_is_told_is_what_is_heard(markers, following):
    told = [MarkerObservation(2.5, k, Pose2D(x, y, theta), np.diag([x * x, 1.0, 2.0])) for k, x, y, theta in markers]
    heard = decode_observations(encode_observations(Observations(2.5, tuple(told), following)))
    assert (heard.stamp, heard.following) == (2.5, following)
    assert [(o.stamp, o.marker_id, o.pose) for o in heard.markers] == [(o.stamp, o.marker_id, o.pose) for o in told]
    for one, other in zip(heard.markers, told, strict=True):
        np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.parametrize("text", ["", "[]", '{"stamp": 1.0}', '{"stamp": 1.0, "markers": [{"marker_id": 0}]}'])
def test_garbage_is_named(text):
    with pytest.raises(MessageError, match="visual_servoing/observations"):
        decode_observations(text)
