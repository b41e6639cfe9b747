# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A robot of map -> odom -> base_link and a camera: TF gives the answer of Odometry."""

import json

from bag_writing import BagFile
from cli_helpers import make_pair, run
import numpy as np
import pytest

from trajectory_calibration.geometry import se3


def seven(T):
    return np.concatenate([T[:3, 3], se3.rotation_to_quaternion(T[:3, :3])])


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Return a bag of transforms, in which the map jumps at loop closures, and one of Odometry."""
    folder = tmp_path_factory.mktemp('robot')
    stamps_ns, a, b = make_pair(400)
    step = np.repeat([[0.002, -0.001, 0.0005, 0, 0, 0.0004]], len(a), axis=0)
    jumps = np.zeros_like(step)
    jumps[[90, 200, 310]] = [[0.3, -0.2, 0, 0, 0, 0.02], [-0.4, 0, 0.1, 0, 0, -0.01],
                             [0.1, 0.1, 0, 0, 0, 0.01]]
    drift = se3.exp_se3(np.cumsum(step, axis=0))
    correction = se3.exp_se3(np.cumsum(jumps, axis=0))
    with BagFile(folder / 'tf') as tf, BagFile(folder / 'odometry', 'sqlite3') as plain:
        for k, stamp in enumerate(stamps_ns.tolist()):
            odom = se3.inverse(drift[k]) @ a[k]
            tf.add('/tf', tf.messages.tf((stamp, seven(odom), 'odom', 'base_link')), stamp)
            tf.add('/tf', tf.messages.tf((stamp, seven(correction[k]), 'map', 'odom')), stamp + 1)
            base = plain.messages.odometry(stamp, seven(correction[k] @ odom), 'map', 'base_link')
            plain.add('/odom', base, stamp)
            for bag in (tf, plain):
                bag.add('/camera', bag.messages.odometry(stamp, seven(b[k]), 'w', 'camera'), stamp)
    return folder


def _answer(capsys, *arguments):
    status, out, err = run(capsys, 'calibrate', *arguments, '--format', 'json')
    assert err == ''
    return status, json.loads(out)


def test_tf_gives_the_answer_of_odometry(bags, capsys):
    status, tf = _answer(capsys, 'tf:map.base_link', 'camera', '--bag', bags / 'tf')
    expected, plain = _answer(capsys, '/odom', '/camera', '--bag', bags / 'odometry')
    assert status == expected
    for part in ('translation', 'rotation_xyzw'):
        np.testing.assert_allclose(tf['T_a_b'][part], plain['T_a_b'][part], atol=1e-9)
    assert (tf['frame_a'], tf['frame_b']) == ('base_link', 'camera')


def test_two_bags_follow_one_option(bags, capsys):
    status, found = _answer(
        capsys, '--bag', bags / 'tf', bags / 'odometry', 'tf:odom.base_link', '/odom')
    assert status == 0
    np.testing.assert_allclose(found['T_a_b']['translation'], 0, atol=0.2)


def test_an_inverted_input_is_turned_round(bags, capsys):
    _, straight = _answer(capsys, 'tf:map.base_link', '/camera', '--bag', bags / 'tf')
    _, inverted = _answer(capsys, 'tf:base_link.map', '/camera', '--bag', bags / 'tf',
                          '--invert-a', '--frame-a', 'base_link')
    np.testing.assert_allclose(
        inverted['T_a_b']['translation'], straight['T_a_b']['translation'], atol=1e-9)
