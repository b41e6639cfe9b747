# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""TF stays a tree: which edge carries an extrinsic, and when none may."""

import numpy as np
import pytest

from trajectory_calibration.geometry import se3
from trajectory_calibration.online.vehicle_frames import difference_in_words, VehicleFrames

T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])
RNG = np.random.default_rng(4)


def vehicle(*edges):
    """Return the frames of a vehicle: 'parent child' is fixed, 'parent ~child' moves."""
    frames = VehicleFrames()
    for text in edges:
        parent, child = text.split()
        T = se3.exp_se3(RNG.normal(size=6))
        frames.add(parent, child.lstrip('~'), T, static=not child.startswith('~'))
    return frames


def placed(frames, a='lidar', b='camera', invented=()):
    """Return 'parent child' of the edge, or the reason; check that the tree gives T_a_b."""
    placement = frames.place(a, b, T_A_B, frozenset(invented))
    edge = placement.edge
    if edge is None:
        return placement.reason
    # What every listener of TF then computes.
    assert frames._edges.get(edge.child) is None
    frames.add(edge.parent, edge.child, edge.T_parent_child, static=True)
    assert np.allclose(frames.transform(a, b), T_A_B, atol=1e-12)
    assert not frames.conflicts
    return f'{edge.parent} {edge.child}'


@pytest.mark.parametrize('edges, expected', [
    ((), 'lidar camera'),
    # The SLAM of a publishes its pose, or the URDF holds a.
    (('map ~lidar',), 'lidar camera'),
    (('odom ~base_link', 'base_link lidar'), 'lidar camera'),
    # The driver of b publishes frames below b.
    (('camera camera_optical',), 'lidar camera'),
    # b is in the URDF already, a is not: a hangs where the URDF hangs.
    (('base_link camera',), 'base_link lidar'),
    (('odom ~base_link', 'base_link mast', 'mast camera'), 'base_link lidar'),
    # b is on a pan-tilt unit.
    (('odom ~base_link', 'base_link ~camera'), 'camera lidar'),
    # Both have a parent; b is what its driver calls the optical frame.
    (('base_link lidar', 'camera_link camera_rgb', 'camera_rgb camera'), 'lidar camera_link'),
    (('odom ~base_link', 'base_link lidar', 'camera_link camera'), 'lidar camera_link'),
])
def test_the_edge_keeps_the_tree(edges, expected):
    assert placed(vehicle(*edges)) == expected


@pytest.mark.parametrize('edges, words', [
    (('base_link lidar', 'base_link camera'), 'already connects lidar and camera'),
    (('lidar camera',), 'already connects lidar and camera'),
    (('camera lidar',), 'already connects lidar and camera'),
    (('odom ~base_link', 'base_link lidar', 'lidar mast', 'mast camera'), 'already connects'),
    (('odom ~base_link', 'base_link lidar', 'world ~camera'), 'in two trees that both move'),
    # Each SLAM publishes its own pose in one map.
    (('map ~lidar', 'map ~camera'), 'switch off the TF of one of the two'),
])
def test_a_second_way_is_refused_with_the_reason(edges, words):
    assert words in placed(vehicle(*edges))


def test_names_that_nobody_gave_never_reach_tf():
    assert 'set frame_b' in placed(vehicle(), invented=['camera'])
    assert 'set frame_a' in placed(vehicle(), invented=['lidar'])
    assert 'both frames are lidar' in placed(vehicle(), b='lidar')


def test_a_leading_slash_is_not_another_frame():
    assert 'already connects' in placed(vehicle('/base_link /lidar', 'base_link camera'))


def test_what_the_node_published_itself_is_not_a_parent_and_a_stranger_is_a_conflict():
    frames = vehicle()
    for T_a_b in (T_A_B, T_A_B @ se3.exp_se3([0.01] * 6)):
        edge = frames.place('lidar', 'camera', T_a_b).edge
        assert (edge.parent, edge.child) == ('lidar', 'camera')
        frames.published(edge)
        frames.add('lidar', 'camera', T_a_b, static=True)
    assert not frames.conflicts
    # robot_state_publisher starts later.
    frames.add('base_link', 'camera', np.eye(4), static=True)
    assert 'another node publishes base_link -> camera' in frames.conflicts[0]


def test_a_frame_with_two_parents_and_a_circle_are_survived():
    frames = vehicle('base_link camera', 'mast camera', 'x y', 'y z', 'z x')
    assert frames.conflicts == ('camera is published with two parents, base_link and mast',)
    edge = frames.place('lidar', 'camera', T_A_B).edge
    assert (edge.parent, edge.child) == ('mast', 'lidar')
    assert frames.transform('x', 'camera') is None
    assert frames.transform('x', 'z') is not None


def test_only_a_fixed_transform_is_compared_with():
    assert vehicle('map ~lidar', 'map ~camera').transform('lidar', 'camera') is None
    assert vehicle('odom ~base', 'base lidar', 'base camera').transform('lidar', 'camera') is not (
        None)


def test_of_a_frame_for_each_object_that_is_tracked_those_of_long_ago_are_forgotten():
    frames = vehicle('odom ~base_link', 'base_link lidar')
    for k in range(5000):
        frames.add('odom', f'track_{k}', np.eye(4), static=False)
        if k % 100 == 0:
            frames.add('odom', 'base_link', np.eye(4), static=False)
    assert len(frames._edges) <= 1000
    # What still comes and what is fixed stays: b hangs below base_link.
    assert 'already connects' in placed(frames, b='base_link')


def test_one_name_for_both_sensors_is_compared_with_nothing():
    # As of two odometries that both give the pose of base_link.
    assert vehicle('odom base_link').transform('base_link', 'base_link') is None


def test_the_transform_of_today_and_how_far_the_answer_is_from_it():
    frames = VehicleFrames()
    assert frames.transform('lidar', 'camera') is None
    frames.add('base_link', 'lidar', se3.exp_se3([1, 0, 2, 0, 0, 0.1]), static=True)
    T_base_camera = frames.transform('base_link', 'lidar') @ T_A_B
    frames.add('base_link', 'camera', T_base_camera, static=True)
    today = frames.transform('lidar', 'camera')
    assert np.allclose(today, T_A_B, atol=1e-12)
    moved = T_A_B.copy()
    moved[:3, 3] += [0.01, 0.0, -0.02]
    assert difference_in_words(moved, today) == (
        '0.0224 m (x +0.0100, y +0.0000, z -0.0200) and 0.000 deg '
        '(about x +0.000, y +0.000, z +0.000)')
