# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Both tracks in one world. Needs no ROS."""

import numpy as np

from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.session import make_overlay

T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])


def overlay_of(poses, bend=0.0):
    rng = np.random.default_rng(4)
    steps = se3.exp_se3(rng.normal(size=(poses, 6)) * 0.05 + [0.1, 0, 0, 0, 0, 0])
    a = np.empty_like(steps)
    a[0] = np.eye(4)
    for k in range(1, poses):
        a[k] = a[k - 1] @ steps[k]
    drift = se3.exp_se3(np.linspace(0, bend, poses)[:, None] * np.array([1.0, 0, 0, 0, 0, 0]))
    b = se3.exp_se3([5.0, -2.0, 1.0, 0.2, 0.1, -0.9]) @ drift @ a @ T_A_B
    stamps_ns = np.arange(poses) * 100_000_000
    trajectories = Trajectory(stamps_ns, a, 'map', 'lidar'), Trajectory(stamps_ns, b)
    result = calibrate(*trajectories, CalibrationConfig(solver='taylor'))
    return make_overlay(*trajectories, result), a


def test_tracks_without_noise_coincide_in_the_world_of_a():
    overlay, a = overlay_of(200)
    assert overlay.world_frame == 'map'
    assert np.allclose(overlay.poses_a, a, atol=1e-12)
    assert np.allclose(overlay.poses_b, a, atol=1e-8)


def test_a_disagreement_is_spread_over_the_drive_and_not_hidden():
    overlay, _ = overlay_of(200, bend=1.0)
    apart = np.linalg.norm(overlay.poses_b[:, :3, 3] - overlay.poses_a[:, :3, 3], axis=1)
    assert 0.2 < apart.max() < 0.8
    assert apart[100] < apart[0]


def test_a_long_drive_is_thinned_for_display():
    overlay, _ = overlay_of(5000)
    assert 1000 < len(overlay.stamps_ns) <= 2000
