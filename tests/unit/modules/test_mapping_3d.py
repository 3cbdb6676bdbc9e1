"""What becomes of depth images during a ride, and of the map after it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import CameraInfo, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.mapping.octree import OctreeParameters, Voxels, read_voxels
from hitchhike_ros.modules.inputs import DepthCameraInfo, DepthImage, NetworkText
from hitchhike_ros.modules.mapping_3d import Mapping3D, Mapping3DOutputs, Mapping3DParameters
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Health, Level, Refused
from hitchhike_ros.protocol.events import GoalCancelled
from hitchhike_ros.protocol.map_transfer import TransferParameters, map_id_of
from hitchhike_ros.protocol.messages import Ack, MapAck, MapOffer, MapRequest, decode, encode
from hitchhike_ros.protocol.status import RideStatus, Status
from plain_files import plain_files

DRIVER, RIDER, THIRD = "p3dx", "turtlebot", "third"
RIDE = RideStatus("ride-1", DRIVER, RIDER)
PERIOD_S = Mapping3DParameters().period_s
SHARE = TransferParameters(piece_bytes=1024, window=4, retry_s=1.0, patience_s=20.0)
INFO = DepthCameraInfo(CameraInfo(9, 9, np.array([(8.0, 0.0, 4.0), (0.0, 8.0, 4.0), (0.0, 0.0, 1.0)])))
T_BASE_CAMERA = np.array([(0.0, 0.0, 1.0, 0.0), (-1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)])
SENSORS = {DepthImage, DepthCameraInfo, PoseEstimate}

ALONE = Status(0.0, DRIVER, "none", "navigating")
COUPLING = Status(0.0, DRIVER, "driver", "aligned", ride=RIDE)
DRIVES = Status(0.0, DRIVER, "driver", "driving", ride=RIDE, convoy=(RIDER,))
RIDES = Status(0.0, RIDER, "hitchhiker", "riding", ride=RIDE)
HAS_LEFT = Status(0.0, RIDER)


def make(robot: str = DRIVER, *, camera: bool = True, **of_share: object) -> Mapping3D:
    tree, share = OctreeParameters(stride=1), replace(SHARE, **of_share)
    return Mapping3D(robot, Mapping3DParameters(), tree, share, T_BASE_CAMERA if camera else None, first_seq=100)


def image(stamp: float, depth_m: float = 1.0) -> DepthImage:
    """Something at a distance straight ahead, and nothing else."""
    pixels = np.full((9, 9), np.nan, np.float32)
    pixels[4, 4] = depth_m
    return DepthImage(stamp, lambda: pixels)


def wild(stamp: float) -> DepthImage:
    """Something in every pixel, of which a large map comes."""
    pixels = np.random.default_rng(round(stamp * 10)).uniform(0.5, 3.5, (9, 9)).astype(np.float32)
    return DepthImage(stamp, lambda: pixels)


def unread(stamp: float) -> DepthImage:
    def read() -> np.ndarray:
        raise AssertionError("it is not to be converted")

    return DepthImage(stamp, read)


def spoilt(stamp: float) -> DepthImage:
    def read() -> np.ndarray:
        raise SensorDataError("depth image encoding 'rgb8'")

    return DepthImage(stamp, read)


def pose(stamp: float, x: float = 0.0) -> PoseEstimate:
    return PoseEstimate(stamp, Pose2D(x), np.zeros((3, 3)))


def hear(its: Mapping3D, now: float, *inputs: object) -> Mapping3DOutputs | None:
    """Hand on inputs and orders at ``now`` and step it as a host would: the outputs, None where it was not due."""
    for x in inputs:
        if isinstance(x, Status):
            its.order(x, now)
        elif (x.what if isinstance(x, Refused) else type(x)) in its.listens():
            its.sense(x, now)
    if its.next_due(now) > now:
        return None
    outputs = its.step(now)
    assert its.next_due(now) > now
    return outputs


def silent(outputs: Mapping3DOutputs | None) -> bool:
    """Whether nothing is said."""
    return outputs is None or replace(outputs, health=Health()) == Mapping3DOutputs(health=Health())


def seen(outputs: Mapping3DOutputs | None) -> Voxels:
    """The map as a viewer sees it after a step that has changed it."""
    assert outputs is not None
    assert outputs.view is not None
    return read_voxels(outputs.view())


@pytest.fixture
def its() -> Mapping3D:
    """A driver that has its rider behind it since 10 s."""
    module = make()
    hear(module, 9.0, COUPLING)
    assert silent(hear(module, 10.0, DRIVES))
    hear(module, 10.0, INFO)
    return module


# When it maps.


def test_off_it_takes_nothing() -> None:
    module = make()
    assert hear(module, 3.0).health == Health(Level.OK, "off")
    for status in (ALONE, COUPLING, replace(ALONE, role="driver"), HAS_LEFT):
        assert hear(module, 4.0, status).health == Health(Level.OK, "off")
        assert module.listens() == frozenset()
        assert module.next_due(4.0) == math.inf
    module.order(GoalCancelled(), 5.0)
    assert module.next_due(5.0) == math.inf


def test_it_maps_while_it_carries_somebody(its: Mapping3D) -> None:
    assert its.listens() == SENSORS
    outputs = hear(its, 10.1, pose(10.1, 2.0), image(10.1))
    assert outputs.health == Health(Level.OK, "mapping", {"images": 1, "points": 1, "nodes": len(its._map)})
    voxels = seen(outputs)
    assert np.abs(voxels.centres - (3.0, 0.0, 0.5)).max() <= voxels.resolution_m
    assert silent(replace(outputs, view=None))
    assert seen(hear(its, 11.2, pose(11.2, 2.0), image(11.2, 2.0))).sides.size == 2


def test_without_a_depth_camera_it_does_not() -> None:
    module = make(camera=False)
    hear(module, 10.0, DRIVES)
    assert module.listens() == frozenset()
    assert module.next_due(10.0) == math.inf


def test_an_image_of_nothing_is_an_image(its: Mapping3D) -> None:
    outputs = hear(its, 10.1, pose(10.1), image(10.1, math.nan))
    assert (outputs.health.level, outputs.health.reason) == (Level.WARN, "mapping")
    assert (outputs.health.counters["images"], outputs.health.counters["points"]) == (1, 0)


def test_an_image_waits_for_the_pose_at_its_stamp(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1, 0.0))
    assert hear(its, 10.15, image(10.15)) is None
    assert its.next_due(10.15) == 10.15 + PERIOD_S
    voxels = seen(hear(its, 10.22, pose(10.2, 0.1)))
    assert np.abs(voxels.centres - (1.05, 0.0, 0.5)).max() <= voxels.resolution_m / 2 + 1e-9  # half way


def test_when_localization_is_behind_a_newer_image_takes_its_place(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1), unread(10.2), unread(10.4))
    assert silent(hear(its, 10.2 + PERIOD_S))
    assert seen(hear(its, 11.3, image(11.3), pose(11.3))).sides.size == 1


def test_an_image_from_before_the_first_pose_is_left_out(its: Mapping3D) -> None:
    assert silent(hear(its, 10.2, unread(10.1), pose(10.2)))
    assert seen(hear(its, 10.3, image(10.3), pose(10.3))).sides.size == 1


def test_between_two_images_in_the_map_lies_a_period(its: Mapping3D) -> None:
    hear(its, 10.1, image(10.1), pose(10.1))
    for stamp in (10.3, 10.7, 11.0):
        assert hear(its, stamp, pose(stamp), unread(stamp)) is None
    assert hear(its, 11.1, pose(11.1), image(10.1 + PERIOD_S)).health.counters["images"] == 2


def test_an_image_that_is_none_is_counted_and_said(its: Mapping3D) -> None:
    outputs = hear(its, 10.1, pose(10.1), spoilt(10.1))
    assert silent(outputs)
    assert outputs.health == Health(Level.ERROR, "depth image encoding 'rgb8'", {"bad_images": 1})
    assert hear(its, 10.2, pose(10.2), unread(10.2)) is None  # its period is over with it
    assert hear(its, 11.3, pose(11.3), image(11.3)).health.reason == "mapping"


def test_a_pose_that_jumps_begins_anew(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1), unread(10.15), pose(10.2, 50.0))
    assert silent(hear(its, 10.25))
    outputs = hear(its, 10.3, image(10.3), pose(10.3, 50.0))
    assert outputs.health.counters["pose_jumps"] == 1


def test_a_pose_that_cannot_be_read_is_counted(its: Mapping3D) -> None:
    assert hear(its, 10.1, Refused(PoseEstimate, "not finite")).health.counters == {"bad_poses": 1}


@pytest.mark.parametrize(
    ("there", "reason"),
    [
        ([INFO, pose(10.1)], "no depth image for {:.1f} s"),
        ([pose(10.1), unread(10.1)], "no depth image for {:.1f} s"),
        ([INFO, pose(10.1), unread(12.7)], "no pose at the image's stamp for {:.1f} s"),
    ],
    ids=["no image", "no calibration", "no pose"],
)
def test_what_stays_away_for_long_is_said(there: list[object], reason: str) -> None:
    module = make()
    hear(module, 10.0, DRIVES)
    hear(module, 10.1, *there)
    assert hear(module, 12.9, DRIVES).health.level is Level.OK
    assert module.next_due(12.9) == 13.0
    assert module.step(13.0).health == Health(Level.ERROR, reason.format(3.0))
    if "pose" not in reason:  # else that image has been given up meanwhile
        hear(module, 13.5, DRIVES)
        assert module.next_due(13.5) == 14.0
        assert module.step(14.0).health == Health(Level.ERROR, reason.format(4.0))


def test_after_an_image_the_silence_counts_from_it(its: Mapping3D) -> None:
    hear(its, 12.0, pose(12.0), image(12.0), DRIVES)
    assert its.next_due(12.0) == 15.0
    assert hear(its, 15.0).health.reason == "no depth image for 3.0 s"
    assert hear(its, 15.1, pose(15.1), image(15.1)).health.level is Level.OK


def test_an_order_that_is_not_repeated_ends_the_mapping(its: Mapping3D) -> None:
    now = 10.0 + ORDER_MAX_AGE_S
    hear(its, 13.0, pose(13.0), image(13.0))
    assert its.next_due(13.0) == now
    outputs = hear(its, now)
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, f"no status for {ORDER_MAX_AGE_S} s")
    assert hear(its, 14.1, pose(14.1), unread(14.1)) is None
    assert its.next_due(14.1) == math.inf
    assert its.listens() == SENSORS
    hear(its, 15.0, DRIVES)
    assert hear(its, 15.2, pose(15.2), image(15.2)).health.reason == "mapping"


def test_while_it_does_not_carry_the_sensors_are_off_and_the_map_stays(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1), image(10.1))
    hear(its, 10.2, pose(10.2), unread(11.15))
    hear(its, 11.2, replace(DRIVES, state="aligning"))  # for one more rider
    assert its.listens() == {NetworkText}
    hear(its, 15.0, DRIVES)
    assert hear(its, 15.1, unread(15.1)) is None
    assert silent(hear(its, 15.15, pose(15.2)))  # the poses of before are forgotten, too
    assert seen(hear(its, 15.3, pose(15.3), image(15.3, 2.0))).sides.size == 2


def test_the_map_of_a_ride_is_not_that_of_the_next(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1), image(10.1))
    hear(its, 10.2, ALONE)
    hear(its, 50.0, replace(DRIVES, ride=replace(RIDE, ride_id="ride-2")))
    hear(its, 50.0, INFO)
    assert seen(hear(its, 50.1, pose(50.1), image(50.1, 2.0))).sides.size == 1


def test_when_the_clock_is_set_back_it_begins_anew(its: Mapping3D) -> None:
    hear(its, 20.0, DRIVES, pose(20.0), image(20.0))
    hear(its, 21.2, unread(21.2))
    assert its.next_due(5.0) <= 5.0
    assert hear(its, 5.0, DRIVES).health.reason == "mapping"
    assert its.next_due(5.0) == 8.0
    assert seen(hear(its, 5.1, pose(5.1), image(5.1, 2.0))).sides.size == 2


# The way to the hitchhiker.


def messages(outputs: Mapping3DOutputs | None) -> list[object]:
    return [] if outputs is None else [decode(text) for text in outputs.messages]


def drive(module: Mapping3D, start: float, images: int = 8) -> bytes:
    """A ride with some images; the map of its end."""
    hear(module, start, DRIVES)
    for i in range(images):
        now = start + 1.1 * i + 0.1
        outputs = hear(module, now, INFO, DRIVES, pose(now, 0.5 * i), wild(now))
    return outputs.view()


class Pair:
    """A driver and its rider, stepped when they are due; what they say arrives a moment later."""

    def __init__(self) -> None:
        self.robots = {DRIVER: make(), RIDER: make(RIDER, camera=False)}
        self.said: dict[str, list[Mapping3DOutputs]] = {DRIVER: [], RIDER: []}
        self.lost = False
        self.content = drive(self.robots[DRIVER], 10.0)
        hear(self.robots[RIDER], 18.0, RIDES)

    def run(self, now: float, end: float) -> None:
        way: list[tuple[float, str]] = []
        while now < end:
            arrived, way = [text for at, text in way if at <= now], [(at, text) for at, text in way if at > now]
            for name, robot in self.robots.items():
                outputs = hear(robot, now, *(NetworkText(text) for text in arrived))
                if outputs is not None:
                    self.said[name].append(outputs)
                    way += [] if self.lost else [(now + 0.02, text) for text in outputs.messages]
            steps = [robot.next_due(now) for robot in self.robots.values()]
            now = min(*steps, *(at for at, _ in way), end)

    def transfers(self, name: str) -> Iterator[tuple[str, str]]:
        return ((t.side, t.state) for outputs in self.said[name] for t in outputs.transfers)


def test_the_map_arrives_bit_for_bit_and_both_are_off_again() -> None:
    pair = Pair()
    driver, rider = pair.robots[DRIVER], pair.robots[RIDER]
    outputs = hear(driver, 19.0, ALONE)
    assert outputs.file == outputs.view() == pair.content
    assert (driver.listens(), outputs.health.reason) == ({NetworkText}, "transferring a map")
    outputs = hear(rider, 19.0, HAS_LEFT)
    assert [type(m) for m in messages(outputs)] == [MapRequest]
    assert (messages(outputs)[0].seq, messages(outputs)[0].time_stamp) == (101, 19.0)
    assert rider.listens() == {NetworkText}
    pair.run(19.1, 25.0)
    assert list(pair.transfers(DRIVER)) == [("driver", "moving"), ("driver", "arrived")]
    assert list(pair.transfers(RIDER)) == [("hitchhiker", "moving"), ("hitchhiker", "arrived")]
    assert [o.file for o in pair.said[RIDER] if o.file is not None] == [pair.content]
    assert [o.view() for o in pair.said[RIDER] if o.view is not None] == [pair.content]
    sent = pair.said[DRIVER][-1].health.counters
    got = pair.said[RIDER][-1].health.counters
    assert (sent["driver_state"], got["hitchhiker_state"]) == ("arrived", "arrived")
    assert sent["driver_map_id"] == got["hitchhiker_map_id"] == map_id_of(pair.content)
    assert sent["driver_pieces"] == got["hitchhiker_pieces"] > 1
    assert driver.listens() == frozenset()
    assert driver.next_due(25.0) == math.inf
    # The driver might ask how it went, for as long as it has patience.
    assert rider.listens() == {NetworkText}
    pair.run(25.0, 60.0)
    assert rider.listens() == frozenset()
    assert rider.next_due(60.0) == math.inf
    assert pair.said[RIDER][-1].health.reason == "off"
    assert sum(len(said.transfers) for said in pair.said[RIDER]) == 2


def test_a_driver_that_asks_how_it_went_is_answered() -> None:
    pair = Pair()
    hear(pair.robots[DRIVER], 19.0, ALONE)
    hear(pair.robots[RIDER], 19.0, HAS_LEFT)
    pair.run(19.1, 25.0)
    of_this = {"map_id": map_id_of(pair.content), "map_bytes": 9, "packed_bytes": 9, "piece_bytes": 1024}
    offer = MapOffer(robot_id=DRIVER, to=RIDER, ride_id="ride-1", seq=999, time_stamp=26.0, **of_this)
    answer = hear(pair.robots[RIDER], 26.0, NetworkText(encode(offer)))
    assert [(m.arrived, m.to) for m in messages(answer) if isinstance(m, MapAck)] == [(True, DRIVER)]
    assert answer.transfers == ()
    assert answer.file is None


def test_who_hears_nothing_gives_up_and_says_so() -> None:
    pair = Pair()
    pair.lost = True
    hear(pair.robots[DRIVER], 19.0, ALONE)
    hear(pair.robots[RIDER], 19.0, HAS_LEFT)
    pair.run(19.1, 19.0 + SHARE.patience_s + 0.5)
    assert list(pair.transfers(DRIVER)) == [("driver", "failed")]
    assert list(pair.transfers(RIDER)) == [("hitchhiker", "failed")]
    asked = [said for said in pair.said[RIDER] if said.messages]
    assert len(asked) == round(SHARE.patience_s / SHARE.retry_s) - 1
    pair.run(40.0, 70.0)
    assert pair.robots[RIDER].listens() == pair.robots[DRIVER].listens() == frozenset()


def test_what_is_no_map_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = Pair()
    monkeypatch.setattr("hitchhike_ros.mapping.octree.OccupancyOctree.file", lambda _self: b"# no octree" * 40)
    hear(pair.robots[DRIVER], 19.0, ALONE)
    hear(pair.robots[RIDER], 19.0, HAS_LEFT)
    pair.run(19.1, 25.0)
    assert list(pair.transfers(RIDER)) == [("hitchhiker", "moving"), ("hitchhiker", "refused")]
    assert all(said.file is None for said in pair.said[RIDER])
    (last,) = [t for said in pair.said[RIDER] for t in said.transfers if t.over]
    assert "the map" in last.reason


def test_a_rider_that_leaves_gets_the_map_as_it_is_then_and_the_others_ride_on() -> None:
    module = make()
    two = replace(DRIVES, convoy=(RIDER, THIRD))
    hear(module, 10.0, two)
    hear(module, 10.0, INFO)
    content = hear(module, 10.1, pose(10.1), image(10.1)).view()
    outputs = hear(module, 10.2, replace(two, convoy=(THIRD,), ride=replace(RIDE, hitchhiker=THIRD)))
    assert outputs.file == content
    assert module.listens() == SENSORS | {NetworkText}
    assert outputs.health.reason == "mapping"
    assert seen(hear(module, 11.3, pose(11.3), image(11.3, 2.0))).sides.size == 2
    request = MapRequest(robot_id=RIDER, to=DRIVER, ride_id="ride-1", seq=1, time_stamp=11.4)
    (offer,) = messages(hear(module, 11.4, NetworkText(encode(request))))
    assert isinstance(offer, MapOffer)
    assert (offer.to, offer.ride_id, offer.map_id) == (RIDER, "ride-1", map_id_of(content))
    stranger = replace(request, robot_id=THIRD, ride_id="x", seq=2)
    assert messages(hear(module, 11.5, NetworkText(encode(stranger)))) == []


def test_the_ride_of_the_map_is_the_one_that_the_status_named_for_that_rider(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1), image(10.1))
    hear(its, 10.2, replace(DRIVES, ride=None))
    hear(its, 10.3, ALONE)
    other = MapRequest(robot_id=RIDER, to=DRIVER, ride_id="ride-0", seq=1, time_stamp=10.4)
    assert messages(hear(its, 10.4, NetworkText(encode(other)))) == []
    assert messages(hear(its, 10.5, NetworkText(encode(replace(other, ride_id="ride-1", seq=2))))) != []


def test_an_empty_map_is_nobodys(its: Mapping3D) -> None:
    outputs = hear(its, 10.2, ALONE)
    assert silent(outputs)
    assert outputs.health.reason == "off"
    assert its.listens() == frozenset()


def test_orders_that_come_together_are_followed_one_by_one(its: Mapping3D) -> None:
    hear(its, 10.1, pose(10.1), image(10.1))
    outputs = hear(its, 10.2, ALONE, DRIVES)
    assert outputs.file is not None
    assert its.listens() == SENSORS | {NetworkText}


def test_a_ride_that_goes_on_is_not_over() -> None:
    module = make(RIDER, camera=False)
    hear(module, 1.0, RIDES)
    for state in ("seeking", "locating", "catching_up", "recoupling", "settling"):
        assert silent(hear(module, 2.0, replace(RIDES, state=state)))
        assert module.listens() == frozenset()
    (asked,) = messages(hear(module, 3.0, HAS_LEFT))
    assert (asked.to, asked.ride_id) == (DRIVER, "ride-1")
    assert messages(hear(module, 3.1, HAS_LEFT)) == []


def test_the_next_ride_is_asked_for_in_place_of_the_one_before() -> None:
    module = make(RIDER, camera=False)
    hear(module, 1.0, RIDES)
    hear(module, 3.0, HAS_LEFT)
    hear(module, 4.0, replace(RIDES, ride=RideStatus("ride-2", THIRD, RIDER)))
    (asked,) = messages(hear(module, 5.0, HAS_LEFT))
    assert (asked.to, asked.ride_id) == (THIRD, "ride-2")


def test_noise_is_dropped_and_counted_and_what_is_for_others_is_left_alone() -> None:
    module = make(RIDER, camera=False)
    hear(module, 1.0, RIDES)
    hear(module, 2.0, HAS_LEFT)
    for i, text in enumerate(('{"map_', '{"version":1,"type":"map_spell"}')):
        outputs = hear(module, 2.1, NetworkText(text))
        assert silent(outputs)
        assert outputs.health.counters["dropped"] == i + 1
    assert hear(module, 2.2, NetworkText("{ no JSON")) is None  # the machines' business
    assert (
        hear(module, 2.2, NetworkText(encode(Ack(robot_id=DRIVER, to=RIDER, ride_id="r", of="driver", acknowledges=3))))
        is None
    )
    elsewhere = MapRequest(robot_id=THIRD, to=DRIVER, ride_id="ride-1", seq=1, time_stamp=2.0)
    assert silent(hear(module, 2.3, NetworkText(encode(elsewhere))))


def test_a_transfer_goes_on_after_the_clock_was_set_back() -> None:
    module = make(RIDER, camera=False)
    hear(module, 101.0, RIDES)
    hear(module, 102.0, HAS_LEFT)
    assert module.next_due(5.0) <= 5.0
    assert len(messages(hear(module, 5.0))) == 1
    assert module.next_due(5.0) == 6.0


def test_it_is_made_of_a_robots_files() -> None:
    driver = Mapping3D.build(
        plain_files("p3dx", mapping_3d={"period_s": 0.5}, octree={"resolution_m": 0.1, "stride": 1})
    )
    hear(driver, 10.0, DRIVES)
    hear(driver, 10.0, INFO)
    voxels = seen(hear(driver, 10.1, pose(10.1), image(10.1)))
    assert voxels.resolution_m == 0.1
    assert 1.0 < voxels.centres[0, 0] < 1.5  # the camera is on top and in front
    assert seen(hear(driver, 10.7, pose(10.7), image(10.7, 2.0))).sides.size == 2
    rider = Mapping3D.build(plain_files("turtlebot", map_transfer={"retry_s": 0.25}))
    hear(rider, 10.0, replace(DRIVES, robot_id="turtlebot"))
    assert rider.listens() == frozenset()
    hear(rider, 11.0, RIDES)
    (asked,) = messages(hear(rider, 12.0, HAS_LEFT))
    assert (asked.robot_id, asked.seq) == ("turtlebot", 71)
    assert rider.next_due(12.0) == 12.25


# Pace.

request = MapRequest(robot_id=RIDER, to=DRIVER, ride_id="ride-1", seq=1, time_stamp=0.0)
orders = st.sampled_from([DRIVES, ALONE, COUPLING, replace(RIDES, robot_id=DRIVER)])
others = st.sampled_from([INFO, Refused(PoseEstimate, "?"), NetworkText('{"map_'), "image", "pose", "both", "request"])
pauses = st.floats(0.0, 2.0) | st.sampled_from([PERIOD_S, SHARE.retry_s, SHARE.patience_s, ORDER_MAX_AGE_S, -1000.0])


@given(st.lists(st.tuples(pauses, st.floats(0.0, 0.99), orders | others), max_size=25))
def test_nothing_happens_before_it_is_due_and_then_it_is_done(events: list[tuple[float, float, object]]) -> None:
    module, now, seq = make(), 50.0, 0
    hear(module, now)
    for pause, share, x in events:
        due = module.next_due(now)
        early = now + share * (min(due, now + 5.0) - now)
        assert silent(module.step(early))
        assert module.next_due(early) == due
        now, seq = early + pause, seq + 1
        made = {
            "image": [image(now)],
            "pose": [pose(now)],
            "both": [image(now), pose(now)],
            "request": [NetworkText(encode(replace(request, seq=seq, time_stamp=now)))],
        }
        hear(module, now, *(made[x] if isinstance(x, str) else [x]))
