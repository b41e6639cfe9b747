# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Damaged bags give what is whole, with a warning, or one named error; never anything else."""

import shutil

from bag_writing import BagFile, make_track, write_bag
import numpy as np
import pytest

from trajectory_calibration import CalibrationError, SourceError, TrajectoryError
from trajectory_calibration.sources.bags import BagSource, open_bags

COUNT = 50
_ZSTD_MAGIC = bytes.fromhex('28b52ffd')
STORAGES = ('mcap', 'mcap zstd', 'sqlite3', 'sqlite3 message', 'sqlite3 file', 'ros1')
STAMPS_NS, POSES = make_track(COUNT, 1)


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags')
    return {storage: write_bag(
        folder / (storage.replace(' ', '_') + '.bag' * (storage == 'ros1')), storage, COUNT)
        for storage in STORAGES}


def _copy(bag, folder):
    """Return a copy of a bag and the file in it that holds the messages."""
    target = folder / bag.name
    if bag.is_file():
        shutil.copy(bag, target)
        return target, target
    shutil.copytree(bag, target)
    return target, next(item for item in target.iterdir() if item.name != 'metadata.yaml')


def _check(bag):
    """Read a bag; return how many poses it gave, or None with a named error."""
    try:
        trajectory = BagSource([bag], '/odom').load()
    except CalibrationError as error:
        assert isinstance(error, SourceError)
        assert not isinstance(error, TrajectoryError)
        assert str(bag) in str(error) or '/odom' in str(error)
        assert '\n' not in str(error)
        return None
    if len(trajectory) < COUNT:
        assert trajectory.warnings, f'{COUNT - len(trajectory)} poses are lost in silence'
    return len(trajectory)


@pytest.mark.parametrize('storage', STORAGES)
def test_cut_at_many_places(bags, tmp_path, storage):
    bag, file = _copy(bags[storage], tmp_path)
    data = file.read_bytes()
    found = []
    for end in np.linspace(0, len(data) - 1, 40).astype(int).tolist():
        file.write_bytes(data[:end])
        found.append(_check(bag))
    assert found[0] is None
    if storage in ('mcap', 'sqlite3'):
        # Not a matter of luck: half of the cuts leave poses.
        assert sum(count is not None for count in found) > 20


@pytest.mark.parametrize('storage', STORAGES)
def test_flipped_bytes(bags, tmp_path, storage):
    bag, file = _copy(bags[storage], tmp_path)
    data = file.read_bytes()
    rng = np.random.default_rng(7)
    for _ in range(60):
        damaged = bytearray(data)
        for position in rng.integers(0, len(data), size=rng.integers(1, 5)):
            damaged[position] ^= rng.integers(1, 256)
        file.write_bytes(damaged)
        _check(bag)


@pytest.mark.slow
@pytest.mark.parametrize('storage', STORAGES)
def test_two_hundred_and_fifty_damaged_bags(bags, tmp_path, storage):
    """Flipped bits, flipped bytes, cuts, holes: no traceback, nothing lost in silence."""
    bag, file = _copy(bags[storage], tmp_path)
    data = file.read_bytes()
    rng = np.random.default_rng(11)
    for k in range(250):
        damaged = bytearray(data)
        position = int(rng.integers(0, len(data)))
        if k % 5 == 0:
            del damaged[position:]
        elif k % 5 == 1:
            size = int(rng.integers(1, 4096))
            damaged[position:position + size] = bytes(len(damaged[position:position + size]))
        else:
            for where in rng.integers(0, len(data), size=rng.integers(1, 4)):
                damaged[where] ^= 1 << int(rng.integers(8)) if k % 5 == 2 else rng.integers(1, 256)
        file.write_bytes(damaged)
        _check(bag)
        _check(file)


def test_flipped_bytes_of_the_index(bags, tmp_path):
    """The end of an mcap file, where its reader begins."""
    bag, file = _copy(bags['mcap zstd'], tmp_path)
    data = file.read_bytes()
    rng = np.random.default_rng(8)
    for _ in range(60):
        damaged = bytearray(data)
        damaged[-rng.integers(1, 700)] ^= rng.integers(1, 256)
        file.write_bytes(damaged)
        assert _check(bag) == COUNT


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_how_much_is_missing_is_said(bags, tmp_path, storage):
    bag, file = _copy(bags[storage], tmp_path)
    data = file.read_bytes()
    file.write_bytes(data[:len(data) * 7 // 10])
    trajectory = BagSource([bag], '/odom').load()
    read = len(trajectory)
    assert 2 <= read < COUNT
    kept = np.flatnonzero(np.isin(STAMPS_NS, trajectory.stamps_ns))
    np.testing.assert_array_equal(trajectory.stamps_ns, STAMPS_NS[kept])
    np.testing.assert_array_equal(trajectory.positions, POSES[kept, :3])
    warnings = '\n'.join(trajectory.warnings)
    assert f'{file} is damaged: ' in warnings
    assert f'read {read} of {COUNT} messages, {COUNT - read} missing' in warnings

    alone = BagSource([file], '/odom').load()
    assert len(alone) == read
    assert f'read {read} messages of an unknown number' in '\n'.join(alone.warnings)


def test_metadata_that_declares_more(bags, tmp_path):
    bag, _ = _copy(bags['mcap'], tmp_path)
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text(encoding='utf-8')
    metadata.write_text(text.replace('message_count: 50', 'message_count: 60'), encoding='utf-8')
    trajectory = BagSource([bag], '/odom').load()
    assert len(trajectory) == COUNT
    assert 'read 50 of 60 messages, 10 missing' in trajectory.warnings[0]


@pytest.mark.parametrize('content', [
    None, '', 'rosbag2_bagfile_information: 3', '{', 'a: [1', '\0', '- 1',
    'rosbag2_bagfile_information: {relative_file_paths: 7}'])
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_metadata_missing_or_damaged(bags, tmp_path, storage, content):
    bag, file = _copy(bags[storage], tmp_path)
    metadata = bag / 'metadata.yaml'
    metadata.unlink()
    if content is not None:
        metadata.write_text(content, encoding='utf-8')
    trajectory = BagSource([bag], '/odom').load()
    np.testing.assert_array_equal(trajectory.stamps_ns, STAMPS_NS)
    reason = 'is missing' if content is None else 'is damaged'
    assert f'metadata.yaml {reason}' in trajectory.warnings[0]
    assert f'read {file.name}' in trajectory.warnings[0]


def test_a_file_that_the_metadata_lists_is_gone(bags, tmp_path):
    bag, file = _copy(bags['mcap'], tmp_path)
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text(encoding='utf-8')
    metadata.write_text(text.replace(f'- {file.name}', f'- {file.name}\n  - bag_1.mcap', 1),
                        encoding='utf-8')
    trajectory = BagSource([bag], '/odom').load()
    assert len(trajectory) == COUNT
    assert 'lists bag_1.mcap, which do not exist' in trajectory.warnings[0]
    file.unlink()
    with pytest.raises(SourceError, match=r'none of the files that metadata\.yaml lists exists'):
        BagSource([bag], '/odom').load()


def test_one_of_two_bags_damaged_beyond_use(bags, tmp_path):
    broken = tmp_path / 'broken.mcap'
    broken.write_bytes(b'nothing of the kind')
    trajectory = BagSource([broken, bags['mcap']], '/odom').load()
    assert len(trajectory) == COUNT
    assert f'{broken} is damaged' in trajectory.warnings[0]


def test_a_crash_left_a_write_ahead_log(bags, tmp_path):
    bag, file = _copy(bags['sqlite3'], tmp_path)
    file.with_name(f'{file.name}-wal').write_bytes(b'pages')
    trajectory = BagSource([bag], '/odom').load()
    assert f'{file.name}-wal holds messages that were not read' in trajectory.warnings[0]


def test_a_damaged_chunk_costs_only_itself(tmp_path):
    """Large messages put a few in a chunk; one in the middle loses the mark of its stream."""
    stamps_ns, poses = make_track(60)
    with BagFile(tmp_path / 'bag', 'mcap zstd') as bag:
        rng = np.random.default_rng(1)
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            noise = rng.bytes(75_000).hex()
            bag.add('/words', bag.messages.text(noise), stamp)
            bag.add('/pose', bag.messages.pose(stamp, pose), stamp)
    file = tmp_path / 'bag/bag.mcap'
    data = bytearray(file.read_bytes())
    start = data.index(_ZSTD_MAGIC, len(data) // 2)
    data[start:start + 4] = bytes(4)
    file.write_bytes(data)
    trajectory = BagSource([tmp_path / 'bag'], '/pose').load()
    assert 40 <= len(trajectory) < 60
    assert np.isin(trajectory.stamps_ns, stamps_ns).all()
    missing = 60 - len(trajectory)
    assert f'read {len(trajectory)} of 60 messages, {missing} missing' in '\n'.join(
        trajectory.warnings)


@pytest.mark.parametrize(('name', 'message'), [
    ('nothing', 'does not exist; needed a rosbag2 folder or a .mcap, .db3, .bag file'),
    ('file.txt', 'is not a bag; needed'),
    ('folder', 'is not a bag: it holds no metadata.yaml, .mcap or .db3 file; give a folder'),
    ('empty.mcap', 'is damaged: .* nothing in it can be read; copy it again'),
    ('empty.db3', 'is damaged: .* nothing in it can be read'),
    ('empty.bag', 'is damaged: .* nothing in it can be read'),
])
def test_what_is_no_bag(tmp_path, name, message):
    (tmp_path / 'folder').mkdir()
    for file in ('file.txt', 'empty.mcap', 'empty.db3', 'empty.bag'):
        (tmp_path / file).touch()
    with (pytest.raises(SourceError, match=message) as caught, open_bags([tmp_path / name])):
        pass
    assert name in str(caught.value)
