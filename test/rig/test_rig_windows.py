# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Common windows of the sensors, and the noise of each sensor."""

import numpy as np
import pytest

from benchmarks.simulated_rig import RigScenario, simulate_rig
from trajectory_calibration.geometry import se3
from trajectory_calibration.rig.noise import (
    covariances,
    sensor_variances,
    white_and_drift,
)
from trajectory_calibration.rig.shared_noise import joint_covariance
from trajectory_calibration.rig.windows import common_grid, Track, window_levels
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.scenario import Sensor

GAP_NS = 500_000_000


def carried(noises, seed=0, duration=60.0, rate=10.0, **sensor):
    """Return tracks of the base from the true extrinsics, and the extrinsics."""
    scenario = RigScenario(
        {f's{k}': Sensor(rate=rate, noise=noise, **sensor) for k, noise in enumerate(noises)},
        duration)
    run = simulate_rig(scenario, seed)
    X = np.stack(list(run.T_base_sensor.values()))
    return [Track(t.stamps_ns, t.poses @ se3.inverse(x))
            for t, x in zip(run.trajectories.values(), X, strict=True)], X


def test_sensors_without_noise_do_not_differ():
    tracks, _ = carried([Noise()] * 3)
    for level in window_levels(common_grid(tracks, GAP_NS)):
        assert level.known.all()
        np.testing.assert_allclose(level.differences, 0, atol=1e-9)


@pytest.mark.parametrize('column', range(6))
def test_jacobian_of_the_differences_is_the_numeric_one(column):
    tracks, _ = carried([Noise()] * 2, rate=20.0, duration=20.0)
    size = 1e-4
    moved = tracks[1].poses @ se3.inverse(se3.exp_se3(size * np.eye(6)[column]))
    grid_moved = common_grid([tracks[0], Track(tracks[1].stamps_ns, moved)], GAP_NS)
    for level in window_levels(grid_moved)[1:]:
        both = level.known.all(axis=0)
        apart = (level.differences[1] - level.differences[0])[both] / size
        scale = np.abs(level.jacobian[..., column]).max()
        np.testing.assert_allclose(
            apart, level.jacobian[both][..., column], atol=0.02 * scale + 1e-6)


def test_white_noise_and_drift_of_each_sensor_are_separated():
    noises = [Noise(white=0.01, white_rotation=0.001), Noise(white=0.03, white_rotation=0.004),
              Noise(white=0.002, white_rotation=0.0003, walk=0.02, walk_rotation=0.002)]
    tracks, X = carried(noises, duration=200.0)
    grid = common_grid(tracks, GAP_NS)
    levels = window_levels(grid)
    variances = sensor_variances(levels, X)
    found = white_and_drift(levels, variances)
    for noise, known in zip(found[:2], noises[:2], strict=True):
        assert noise.white_m == pytest.approx(known.white, rel=0.15)
        assert noise.white_rad == pytest.approx(known.white_rotation, rel=0.15)
        assert noise.drift_m < 0.005
    assert found[2].white_m < 0.006
    assert found[2].drift_m == pytest.approx(0.02, rel=0.3)
    assert found[2].drift_rad == pytest.approx(0.002, rel=0.3)


def test_windows_that_a_sensor_does_not_cover_are_unknown():
    tracks, _ = carried([Noise(white=0.01)] * 3)
    half = len(tracks[1].stamps_ns) // 2
    tracks[1] = Track(tracks[1].stamps_ns[:half], tracks[1].poses[:half])
    levels = window_levels(common_grid(tracks, GAP_NS))
    assert not levels[0].known[1, -10:].any()
    assert levels[0].known[1, :10].all()
    assert levels[0].known[[0, 2]].all()


def test_errors_of_pairs_with_a_common_sensor_are_correlated():
    tracks, X = carried([Noise(white=0.01, white_rotation=0.001)] * 4)
    levels = window_levels(common_grid(tracks, GAP_NS))
    variances = sensor_variances(levels, X)
    M = joint_covariance(
        levels, covariances(variances, X), [(0, 1), (0, 2), (2, 0), (2, 3), (1, 3)])
    correlation = np.einsum('paqa->pqa', M) / np.sqrt(
        np.einsum('papa->pa', M)[:, None] * np.einsum('qaqa->qa', M)[None])
    # Equal noise: half of the variance of each pair is from the common sensor.
    np.testing.assert_allclose(correlation[0, 1], 0.5, atol=0.15)
    np.testing.assert_allclose(correlation[1, 2], -1.0, atol=1e-9)
    np.testing.assert_allclose(correlation[0, 3], 0.0, atol=1e-9)
    np.testing.assert_allclose(correlation[0, 4], -0.5, atol=0.15)
    assert np.linalg.eigvalsh(M.reshape(30, 30)).min() > -1e-12
