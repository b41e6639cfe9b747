# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The small inputs of real tools that failed once: read rightly, or refused with the option."""

import numpy as np
import pytest

from trajectory_calibration import CalibrationError, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.sources.files import FileSource

# File -> the option that it needs, None for none.
COLUMNS = {
    'colmap_images.txt': {'invert': True},
    'comma_hdr.csv': {}, 'comma_hdr_nohash.csv': {}, 'cov14.txt': {}, 'cov20.txt': {},
    'frame_index.txt': {'times': True}, 'g2o.g2o': {'times': True}, 'id9.txt': {},
    'mat16.txt': {'times': True}, 'ms_space.txt': {}, 'ns_euroc_tumorder_hdr.csv': {},
    'ns_space.txt': {}, 'quat_first.txt': {'columns': 't,qx,qy,qz,qw,x,y,z'},
    'rownum9.csv': {}, 'sec_nsec_cols.csv': {}, 'secs_nsecs.csv': {}, 't_kitti13.txt': {},
    't_mat17.txt': {}, 'transforms.json': {}, 'us_space.txt': {},
    'w_first.txt': {'quaternion_order': 'wxyz'},
}


@pytest.mark.parametrize('name', COLUMNS)
def test_layouts_of_real_tools(shared_data, tmp_path, name):
    folder = shared_data / 'cases/columns'
    expected = FileSource(folder / 'b.tum').load()
    options = dict(COLUMNS[name])
    if options.pop('times', False):
        options['times'] = tmp_path / 'times.txt'
        options['times'].write_text(''.join(
            f'{stamp}\n' for stamp in expected.stamps_ns[:400]), encoding='utf-8')
    # The poses of this file are not inverted as those of COLMAP are.
    inverted = options.pop('invert', False)
    found = FileSource(folder / name, **options).load()
    poses = se3.inverse(found.poses) if inverted else found.poses
    assert len(found) > 40
    # Milliseconds with three decimals are exact to half a microsecond.
    np.testing.assert_allclose(found.stamps_ns, expected.stamps_ns[:len(found)], rtol=0, atol=1500)
    np.testing.assert_allclose(poses, expected.poses[:len(found)], atol=1e-8)


@pytest.mark.parametrize(('name', 'message'), [
    ('euler7.txt', r'7 columns .*--columns t,x,y,z,roll,pitch,yaw'),
    ('quat_first.txt', r'8 columns .*--columns t,qx,qy,qz,qw,x,y,z or'),
    ('g2o.g2o', '--times'), ('mat16.txt', r'carry no time \(16 columns\); .*--times')])
def test_what_is_ambiguous_names_its_option(shared_data, name, message):
    with pytest.raises(SourceError, match=message):
        FileSource(shared_data / 'cases/columns' / name).load()


@pytest.mark.parametrize('name', ['a.tum', 'b.tum'])
def test_fractions_without_leading_zeros(shared_data, name):
    found = FileSource(shared_data / 'cases/unpadded_nanoseconds' / name).load()
    assert [item.code for item in found.findings] == ['stamps-unpadded']
    steps = np.diff(found.stamps_ns)
    assert (steps > 0).all()
    assert np.ptp(steps) < 1e6


@pytest.mark.parametrize(('name', 'message'), [
    ('seven_digits.txt', r'all 1,671 poses have the same time|rounded to .* s \(7 digits\)'),
    ('ten_digits.txt', r'share their time with another: .* rounded to 1 s \(10 digits\)')])
def test_times_that_were_rounded(shared_data, name, message):
    with pytest.raises(CalibrationError, match=message):
        FileSource(shared_data / 'cases/short_stamps' / name).load()
