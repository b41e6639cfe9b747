# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories with a known extrinsic, for tests that need no more than that."""

import numpy as np

from trajectory_calibration import Trajectory
from trajectory_calibration.geometry import se3

STEP_NS = 100_000_000


def random_pose(rng, angle=np.pi, distance=1.0):
    """Return a (4, 4) pose of random axis, angle up to ``angle``, each axis up to ``distance``."""
    axis = rng.normal(size=3)
    axis *= rng.uniform(0, angle) / np.linalg.norm(axis)
    return se3.from_rotation_translation(
        se3.exp_so3(axis), rng.uniform(-distance, distance, size=3))


def wander(rng, poses=100, translation=(0.1, 0.02, 0.02), rotation=(0.1, 0.1, 0.1)):
    """Return (N, 4, 4) poses of a body that moves by random twists of these sizes per step."""
    twists = rng.normal(size=(poses - 1, 6)) * np.concatenate([translation, rotation])
    T = np.empty((poses, 4, 4))
    T[0] = np.eye(4)
    for k, step in enumerate(se3.exp_se3(twists)):
        T[k + 1] = T[k] @ step
    # Thousands of products drift off the group by rounding.
    T[:, :3, :3] = se3.nearest_rotation(T[:, :3, :3])
    return T


def stamps(poses, start_ns=1_700_000_000_000_000_000, step_ns=STEP_NS):
    """Return (N,) int64 nanoseconds at a constant rate."""
    return start_ns + step_ns * np.arange(poses, dtype=np.int64)


def sensor_pair(rng, T_a_b, body=None, **motion):
    """Return the trajectories of a and b, each in a world of its own, rigidly mounted at T_a_b."""
    poses_a = wander(rng, **motion) if body is None else body
    world = random_pose(rng, distance=10.0)
    poses_b = world @ poses_a @ T_a_b
    t = stamps(len(poses_a))
    return (Trajectory(t, poses_a, 'map_a', 'lidar'),
            Trajectory(t, poses_b, 'map_b', 'camera'))


def perturb(rng, trajectory, sigma_t, sigma_r):
    """Return the trajectory with white noise on the body side of every pose (metres, radians)."""
    noise = rng.normal(size=(len(trajectory), 6)) * np.repeat([sigma_t, sigma_r], 3)
    return Trajectory(trajectory.stamps_ns, trajectory.poses @ se3.exp_se3(noise),
                      trajectory.world_frame, trajectory.sensor_frame)
