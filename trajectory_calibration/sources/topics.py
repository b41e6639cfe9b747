"""The messages of one topic, gathered and made into a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import MAX_POSITION, pose_faults, Trajectory
from trajectory_calibration.errors import SourceError, TrajectoryError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources import cdr
from trajectory_calibration.sources.deserialise import Deserialiser

# Messages held as bytes before they become numbers: enough to make NumPy's overhead vanish.
_BLOCK = 8192
_INT64_MAX = 2**63 - 1


@dataclass(frozen=True, eq=False)
class TopicTrack:
    """What one topic holds, as it was recorded: nothing repaired, nothing left out but bytes.

    Attributes
    ----------
    topic, msgtype : name and type.
    messages : how many were read.
    unreadable : how many of them were not.
    stamps_ns, received_ns : (N,) int64, of the header and of the recorder.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw.
    frame_index : (N,), index into ``frames``.
    frames : pairs of header.frame_id and child_frame_id.
    warnings : what is missing from the bag.

    """

    topic: str
    msgtype: str
    messages: int
    unreadable: int
    stamps_ns: NDArray[np.int64]
    received_ns: NDArray[np.int64]
    poses: FloatArray
    frame_index: NDArray[np.intp]
    frames: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...] = ()

    def to_trajectory(
        self, sensor_frame: str | None = None, world_frame: str | None = None,
    ) -> Trajectory:
        """Make a trajectory of what can be used; what cannot is counted in its warnings.

        * Poses in more than one frame are never mixed: the pair of frames with the most poses
          stays.
        * Headers without stamps: the receive time serves if no header has one, otherwise those
          messages go.
        * Poses that are not finite, or whose quaternion is not of unit length, go.

        The names of the frames are those of the messages unless given; a message without a
        child frame gives the sensor the name of its topic.

        Raises
        ------
        SourceError
            Fewer than two poses are left.

        """
        notes = list(self.warnings)
        if self.unreadable:
            notes.append(f'{self.unreadable} of {self.messages} messages cannot be read: dropped')
        keep = np.ones(len(self.poses), dtype=bool)
        world, sensor = self._keep_one_frame(keep, notes)
        stamps_ns = self._keep_stamped(keep, notes)
        self._keep_poses(keep, notes)
        sensor = sensor_frame or sensor or self.topic.strip('/').replace('/', '_')
        world = world_frame or world or 'map'
        if np.count_nonzero(keep) < 2:
            reasons = f' ({"; ".join(notes)})' if notes else ''
            raise SourceError(
                f'{self.topic}: {np.count_nonzero(keep)} of {self.messages} messages give a pose, '
                f'needed at least 2{reasons}; record while the sensor moves')
        try:
            return Trajectory.from_quaternions(
                stamps_ns[keep], self.poses[keep, :3], self.poses[keep, 3:], world, sensor,
                tuple(Finding('input-repaired', f'{sensor}: {self.topic}: {note}')
                      for note in notes))
        except TrajectoryError as error:
            raise SourceError(f'{self.topic}: {error}') from error

    def _keep_one_frame(self, keep: NDArray[np.bool_], notes: list[str]) -> tuple[str, str]:
        if not self.frames:
            return '', ''
        counts = np.bincount(self.frame_index, minlength=len(self.frames))
        most = int(np.argmax(counts))
        if np.count_nonzero(counts) > 1:
            others = ', '.join(
                f'{count} in {_frame_names(frames)}'
                for k, (frames, count) in enumerate(zip(self.frames, counts, strict=True))
                if count and k != most)
            notes.append(f'the frames change: kept {counts[most]} poses in '
                         f'{_frame_names(self.frames[most])}, dropped {others}')
        keep &= self.frame_index == most
        return self.frames[most]

    def _keep_stamped(self, keep: NDArray[np.bool_], notes: list[str]) -> NDArray[np.int64]:
        missing = self.stamps_ns == 0
        count = int(np.count_nonzero(missing & keep))
        if count and count == np.count_nonzero(keep) and self.msgtype != cdr.PATH:
            notes.append('the headers carry no stamps: the times of reception are used')
            return self.received_ns
        if count:
            notes.append(f'{count} headers carry no stamp: dropped')
            keep &= ~missing
        return self.stamps_ns

    def _keep_poses(self, keep: NDArray[np.bool_], notes: list[str]) -> None:
        for bad, what in zip(pose_faults(self.poses), (
                'are not finite', 'have a quaternion that is not of unit length',
                f'lie more than {MAX_POSITION:.0e} m away along an axis'), strict=True):
            if (bad & keep).any():
                notes.append(f'{np.count_nonzero(bad & keep)} poses {what}: dropped')
            keep &= ~bad


class TopicCollector:
    """Gathers the messages of one topic from one file."""

    def __init__(self, topic: str, msgtype: str, *, ros1: bool) -> None:
        self.count = 0
        self._topic, self._msgtype, self._ros1 = topic, msgtype, ros1
        self._deserialiser: Deserialiser | None = None
        self._waiting: list[bytes] = []
        self._received: list[int] = []
        self._parts: list[TopicTrack] = []

    def add(self, message: bytes, received_ns: int) -> None:
        """Take one serialized message and the time the recorder got it."""
        self.count += 1
        # Bags count in unsigned numbers; a damaged one may hold any.
        received_ns = min(received_ns, _INT64_MAX)
        if self._msgtype == cdr.PATH:
            # A SLAM publishes its whole optimised path again and again: the last one counts, but
            # for one without a usable pose. Paths grow: only a shorter one is looked into.
            shorter = bool(self._waiting) and len(message) < len(self._waiting[0])
            path = self._path(message) if shorter else None
            if not shorter or (path is not None and _is_usable(path)):
                if path is not None:
                    self._set_apart(int(path.stamps_ns.min()))
                self._waiting, self._received = [message], [received_ns]
            return
        self._waiting.append(message)
        self._received.append(received_ns)
        if len(self._waiting) == _BLOCK:
            self._flush()

    def track(self) -> TopicTrack:
        """Return everything that was taken."""
        if self._msgtype == cdr.PATH:
            last = self._path_track()
            parts = [*self._parts, last]
            return join_tracks(self._topic, self._msgtype, parts) if self._parts else last
        self._flush()
        return join_tracks(self._topic, self._msgtype, self._parts)

    def _flush(self) -> None:
        messages, received = self._waiting, self._received
        self._waiting, self._received = [], []
        if not messages:
            return
        # ROS 1 data is never taken for CDR: its own layout could look like it by chance.
        block = cdr.parse_poses([] if self._ros1 else messages, self._msgtype)
        if self._ros1:
            block = cdr.PoseBlock(
                np.zeros(len(messages), dtype=np.int64), np.zeros((len(messages), 7)),
                np.full(len(messages), -1), [])
        for k in np.flatnonzero(block.frame_index < 0).tolist():
            sample = self._general.pose(messages[k], self._msgtype)
            if sample is None:
                continue
            if sample.frames not in block.frames:
                block.frames.append(sample.frames)
            block.stamps_ns[k], block.poses[k] = sample.stamp_ns, sample.pose
            block.frame_index[k] = block.frames.index(sample.frames)
        read = block.frame_index >= 0
        self._parts.append(TopicTrack(
            self._topic, self._msgtype, len(messages), len(messages) - np.count_nonzero(read),
            block.stamps_ns[read], np.array(received, dtype=np.int64)[read], block.poses[read],
            block.frame_index[read], tuple(block.frames)))

    def _set_apart(self, start_ns: int) -> None:
        """Keep the path that is held as one of its own where the next one begins after it."""
        held = self._path_track()
        if len(held.poses) and held.stamps_ns.max() < start_ns:
            self._parts.append(replace(held, messages=0))

    def _path(self, message: bytes) -> cdr.PathPoses | None:
        path = None if self._ros1 else cdr.parse_path(message)
        return self._general.path(message) if path is None else path

    def _path_track(self) -> TopicTrack:
        path = self._path(self._waiting[0]) if self._waiting else None
        if path is None:
            return TopicTrack(
                self._topic, self._msgtype, self.count, min(self.count, 1), *_nothing(), ())
        count = len(path.poses)
        received_ns = np.full(count, self._received[0])
        return TopicTrack(
            self._topic, self._msgtype, self.count, 0, path.stamps_ns, received_ns, path.poses,
            np.zeros(count, dtype=np.intp), ((path.frame, ''),))

    @property
    def _general(self) -> Deserialiser:
        if self._deserialiser is None:
            self._deserialiser = Deserialiser(ros1=self._ros1)
        return self._deserialiser


def _is_usable(path: cdr.PathPoses) -> bool:
    return not np.all(np.any([path.stamps_ns == 0, *pose_faults(path.poses)], axis=0))


def join_tracks(
    topic: str, msgtype: str, parts: Sequence[TopicTrack], warnings: tuple[str, ...] = (),
) -> TopicTrack:
    """Put the parts of one topic from several files together, in the order of reception."""
    warnings += tuple(text for part in parts for text in part.warnings)
    filled = sorted((part for part in parts if len(part.poses)),
                    key=lambda part: int(part.received_ns[0]))
    if msgtype == cdr.PATH:
        warnings += tuple(_dropped_note(filled))
        filled = filled[-1:]
    messages, unreadable = (sum(part.messages for part in parts),
                            sum(part.unreadable for part in parts))
    if not filled:
        return TopicTrack(topic, msgtype, messages, unreadable, *_nothing(), (), warnings)
    frames = tuple(dict.fromkeys(pair for part in filled for pair in part.frames))
    return TopicTrack(
        topic, msgtype, messages, unreadable,
        np.concatenate([part.stamps_ns for part in filled]),
        np.concatenate([part.received_ns for part in filled]),
        np.concatenate([part.poses for part in filled]),
        np.concatenate([
            np.array([frames.index(pair) for pair in part.frames])[part.frame_index]
            for part in filled]),
        frames, warnings)


def _dropped_note(paths: Sequence[TopicTrack]) -> list[str]:
    """Say which paths hold poses of a time of their own, which the last path does not replace."""
    if not paths:
        return []
    start, end = paths[-1].stamps_ns.min(), paths[-1].stamps_ns.max()
    apart = [path for path in paths[:-1]
             if path.stamps_ns.max() < start or path.stamps_ns.min() > end]
    if not apart:
        return []
    found = f'{len(apart)} earlier paths with {sum(len(path.poses) for path in apart)} poses'
    advice = 'only the last path is used; calibrate each bag by itself'
    return [f'{found} of another time: dropped, {advice}']


def _nothing() -> tuple[
        NDArray[np.int64], NDArray[np.int64], FloatArray, NDArray[np.intp]]:
    return (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 7)),
            np.zeros(0, dtype=np.intp))


def _frame_names(frames: tuple[str, str]) -> str:
    return ' -> '.join(repr(name) for name in frames if name) or 'no frame'
