# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a node that has calibrated holds for whoever comes later."""

import numpy as np
import pytest
from ros_if_any import needs_ros, ros

pytestmark = [needs_ros, pytest.mark.ros]


@pytest.fixture(scope='module')
def calibrated(tmp_path_factory):
    """Yield a client of a node that has calibrated; what that publishes stays as it is."""
    with ros.running(tmp_path_factory.mktemp('node'), '-p', 'solver:=taylor') as (_, client):
        client.publish_drive(*ros.drive())
        assert client.call('calibrate').success
        yield client


def test_a_late_joiner_gets_the_latched_extrinsic(calibrated):
    late = calibrated.latched()
    calibrated.wait(lambda: late, 'the latched extrinsic')
    assert np.allclose(ros.matrix(late[0]), ros.T_A_B, atol=1e-10)


def test_what_ros2_topic_echo_gets_of_the_latched_extrinsic(calibrated):
    """Without an option `ros2 topic echo` takes the publisher's QoS, with one best effort."""
    plain = ros.QoSProfile(
        depth=1, reliability=ros.ReliabilityPolicy.RELIABLE,
        durability=ros.DurabilityPolicy.TRANSIENT_LOCAL)
    best_effort = ros.QoSProfile(
        depth=1, reliability=ros.ReliabilityPolicy.BEST_EFFORT,
        durability=ros.DurabilityPolicy.TRANSIENT_LOCAL)
    before = calibrated.latched(qos=best_effort)
    late = calibrated.latched(qos=plain)
    calibrated.wait(lambda: late, 'the latched extrinsic')
    # Fast DDS repeats what it keeps for reliable readers only. One that is there in time
    # gets the next answer.
    calibrated.meet()
    calibrated.spin(1.0)
    assert not before
    assert calibrated.call('calibrate').success
    calibrated.wait(lambda: before and len(late) == 2, 'the next extrinsic')
    assert np.allclose(ros.matrix(late[0]), ros.T_A_B, atol=1e-10)


def test_the_tracks_lie_over_each_other(calibrated):
    _, poses_a, _ = ros.drive()
    path_a = calibrated.latched('trajectory_calibration/path_a', ros.TYPES['Path'])
    path_b = calibrated.latched('trajectory_calibration/path_b', ros.TYPES['Path'])
    markers = calibrated.latched('trajectory_calibration/markers', ros.MarkerArray)
    calibrated.wait(lambda: path_a and path_b and markers, 'the tracks')
    positions_a, positions_b = (
        np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z]
                  for p in path[0].poses]) for path in (path_a, path_b))
    assert path_a[0].header.frame_id == path_b[0].header.frame_id == 'map'
    assert np.allclose(positions_a, poses_a[:, :3, 3], atol=1e-12)
    assert np.allclose(positions_b, positions_a, atol=1e-9)
    lines, text = markers[0].markers
    assert len(lines.points) == 200
    assert text.text == 'lidar -> camera: tracks 0.000 m apart (rms)'
