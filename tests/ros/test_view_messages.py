# SPDX-License-Identifier: Apache-2.0
"""The serialised messages of a scene decode as ROS 2 messages, without loss."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker, MarkerArray

from flock_tools.scene import messages
from flock_tools.scene.marker import Kind
from flock_tools.scene.shapes import scene
from flock_tools.scene.upwash_image import upwash_image
from unit.scene.test_shapes import snapshot

SHOWN = scene(snapshot(), [snapshot().along - 1.0])


def test_markers_are_those_of_visualization_msgs() -> None:
    data = messages.markers(SHOWN, anew=False)
    array = deserialize_message(data, MarkerArray)
    assert len(array.markers) == len(SHOWN.shapes)
    for marker, shape in zip(array.markers, SHOWN.shapes, strict=True):
        assert (marker.ns, marker.id, marker.type) == (shape.group, shape.number, shape.kind)
        assert (marker.action, marker.header.frame_id) == (Marker.ADD, "flock")
        assert (marker.header.stamp.sec, marker.header.stamp.nanosec) == (1, 2)
        place, turn = marker.pose.position, marker.pose.orientation
        assert (place.x, place.y, place.z) == shape.origin
        assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)
        assert (marker.scale.x, marker.scale.y, marker.scale.z) == pytest.approx(shape.scale)
        assert marker.text == shape.text
        points = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3)
        assert (points == shape.points).all()
        colours = np.array([(c.r, c.g, c.b, c.a) for c in marker.colors]).reshape(-1, 4)
        assert colours == pytest.approx(shape.colours[: len(points)], rel=1e-6)
    # And written again by others, they are the same bytes, but for what fills the gaps.
    assert len(serialize_message(array)) == len(data)


def test_the_kinds_of_shapes_are_those_of_markers() -> None:
    assert Kind.LINE == Marker.LINE_STRIP
    assert Kind.CUBES == Marker.CUBE_LIST
    assert Kind.TEXT == Marker.TEXT_VIEW_FACING
    assert Kind.TRIANGLES == Marker.TRIANGLE_LIST


def test_what_was_shown_before_is_removed_first() -> None:
    array = deserialize_message(messages.markers(SHOWN, anew=True), MarkerArray)
    assert [marker.action for marker in array.markers[:2]] == [Marker.DELETEALL, Marker.ADD]
    assert len(array.markers) == len(SHOWN.shapes) + 1


def test_the_images_are_those_of_sensor_msgs() -> None:
    for pixels, encoding in (
        (SHOWN.upwash, messages.NUMBERS),
        (upwash_image(SHOWN), messages.COLORS),
    ):
        image = deserialize_message(messages.image(SHOWN.snapshot, pixels, encoding), Image)
        assert (image.height, image.width) == pixels.shape[:2]
        assert (image.encoding, image.is_bigendian) == (encoding, 0)
        assert (image.header.frame_id, image.step) == ("flock", pixels.nbytes // image.height)
        found = np.frombuffer(image.data, dtype=pixels.dtype).reshape(pixels.shape)
        assert (found == pixels).all()


def test_the_transform_takes_the_flock_to_where_its_leader_is() -> None:
    told = deserialize_message(messages.transform(SHOWN.snapshot), TransformStamped)
    assert (told.header.frame_id, told.child_frame_id) == ("world", "flock")
    shift = told.transform.translation
    assert (shift.x, shift.y, shift.z) == (800.0, 0.0, 0.0)  # b = 0.8 m
    assert told.transform.rotation.w == 1.0
    # There is no wheel of tf2_msgs; others know the type.
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(messages.transforms(SHOWN.snapshot), "tf2_msgs/msg/TFMessage")
    (same,) = message.transforms
    assert (same.header.frame_id, same.child_frame_id) == ("world", "flock")
    assert (same.header.stamp.sec, same.header.stamp.nanosec) == (1, 2)
    assert same.transform.translation.x == 800.0
    assert same.transform.rotation.w == 1.0


@pytest.mark.parametrize("bird", [1, 3, 5])
def test_odometry_is_that_of_nav_msgs(bird: int) -> None:
    snapshot = SHOWN.snapshot
    expected = Odometry()
    expected.header.stamp.sec, expected.header.stamp.nanosec = 1, 2
    expected.header.frame_id, expected.child_frame_id = "world", f"bird_{bird:02d}"
    place = expected.pose.pose.position
    place.x = 0.8 * float(snapshot.state.position[bird - 1])  # b = 0.8 m
    place.y = 0.0 - 0.8 * float(snapshot.lateral[bird - 1])
    expected.twist.twist.linear.x = 17.0 * 1.2  # U_min = 17 m/s
    data = messages.odometry(snapshot, bird)
    assert deserialize_message(data, Odometry) == expected
    written = bytearray(serialize_message(expected))
    gap = data.index(b"world\0") + 6
    written[gap : gap + 2] = bytes(2)  # what fills the gap has no meaning
    assert data == bytes(written)


def test_tf_has_the_frames_of_birds_beside_that_of_the_flock() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    data = messages.transforms(SHOWN.snapshot, [1, 3, 5])
    flock, *birds = store.deserialize_cdr(data, messages.TRANSFORMS).transforms
    assert flock.child_frame_id == "flock"
    assert [told.child_frame_id for told in birds] == ["bird_01", "bird_03", "bird_05"]
    for told, place in zip(birds, SHOWN.snapshot.world[[0, 2, 4]], strict=True):
        assert told.header == flock.header
        shift, turn = told.transform.translation, told.transform.rotation
        assert (shift.x, shift.y, shift.z) == tuple(place)
        assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)
    leader = birds[1].transform.translation
    assert (leader.x, leader.y) == (flock.transform.translation.x, 0.0)
