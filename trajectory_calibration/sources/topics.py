# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Collect the messages of one topic, and convert them to a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import pose_faults, Trajectory
from trajectory_calibration.errors import counted
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources import cdr
from trajectory_calibration.sources.channels import Batch
from trajectory_calibration.sources.edges import fault_words, FAULTS
from trajectory_calibration.sources.transforms import parse_tf, TransformTree
from trajectory_calibration.sources.usable import UsablePoses


@dataclass(frozen=True, eq=False)
class TopicTrack:
    """The recorded poses of one topic, before any check or repair.

    Attributes
    ----------
    topic, msgtype : name and type.
    messages : number of messages read.
    unreadable : number of those that could not be parsed.
    refused : (3,), number of invalid transforms of a chain by the kinds of ``pose_faults``.
    stamps_ns, received_ns : (N,) int64, header stamp and receive time.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw.
    frame_index : (N,), index into ``frames``.
    frames : pairs of header.frame_id and child_frame_id.
    warnings : messages missing from the bag.
    notes : messages dropped on purpose.

    """

    topic: str
    msgtype: str
    messages: int
    unreadable: int
    stamps_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    received_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    poses: FloatArray = field(default_factory=lambda: np.zeros((0, 7)))
    frame_index: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    frames: tuple[cdr.TwoFrames, ...] = ()
    refused: tuple[int, ...] = (0, 0, 0)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def only(self, keep: NDArray[np.bool_]) -> TopicTrack:
        """Return the track with the poses selected by the (N,) mask."""
        return replace(
            self, stamps_ns=self.stamps_ns[keep], received_ns=self.received_ns[keep],
            poses=self.poses[keep], frame_index=self.frame_index[keep])

    def to_trajectory(
        self, sensor_frame: str | None = None, world_frame: str | None = None,
    ) -> Trajectory:
        """Return the trajectory of the usable poses; findings count the dropped ones.

        * Poses in different frames are never mixed: only the pair of frames with the most poses
          is kept.
        * If no header has a stamp, the receive times are used; otherwise messages without a stamp
          are dropped.
        * Poses that are not finite, too far away, or whose quaternion is not of unit length, are
          dropped.

        Frame names default to those of the messages; without a child frame, the sensor has the
        name of the topic.

        Raise SourceError if fewer than two poses are left.
        """
        usable = UsablePoses(self.topic, counted(self.messages, 'message'), self.poses, [
            *(Finding('bag-damaged', text) for text in self.warnings),
            *(Finding('input-repaired', text) for text in self.notes)], of_one=False)
        notes = usable.findings
        if self.unreadable:
            notes.append(Finding(
                'input-repaired',
                f'dropped {self.unreadable} of {usable.rows}: unreadable'))
        if any(self.refused):
            notes.append(Finding(
                'poses-lost', f'dropped {counted(sum(self.refused), "transform")}: '
                f'{fault_words(self.refused)}'))
        world, sensor = self._keep_one_frame(usable.keep, notes)
        stamps_ns, missing = self.stamps_ns, self.stamps_ns == 0
        if usable.keep.any() and missing[usable.keep].all() and self.msgtype != cdr.PATH:
            notes.append(Finding(
                'input-repaired',
                'the headers carry no stamps: the times of reception are used'))
            stamps_ns = self.received_ns
        else:
            usable.drop(missing, ' without a stamp', 'input-repaired')
        for bad, why in zip(pose_faults(self.poses), FAULTS, strict=True):
            usable.drop(bad, f': {why}')
        return usable.to_trajectory(
            stamps_ns, world_frame or world or 'map',
            sensor_frame or sensor or self.topic.strip('/').replace('/', '_'),
            'use a topic whose messages carry the time of each pose')

    def _keep_one_frame(self, keep: NDArray[np.bool_], notes: list[Finding]) -> tuple[str, str]:
        if not self.frames:
            return '', ''
        # tf2 refuses names with the leading slash that ROS 1 had.
        plain = [(frame.lstrip('/'), child.lstrip('/')) for frame, child in self.frames]
        names = list(dict.fromkeys(plain))
        index = np.array([names.index(pair) for pair in plain])[self.frame_index]
        counts = np.bincount(index, minlength=len(names))
        largest = int(np.argmax(counts))
        if np.count_nonzero(counts) > 1:
            others = ', '.join(
                f'{count} in {_frame_words(frames)}'
                for k, (frames, count) in enumerate(zip(names, counts, strict=True))
                if count and k != largest)
            notes.append(Finding(
                'input-repaired', f'the frames change: kept {counted(counts[largest], "pose")} in '
                f'{_frame_words(names[largest])}, dropped {others}'))
        slashed = [name for pair in self.frames for name in pair if name.startswith('/')]
        if slashed:
            notes.append(Finding(
                'frame-renamed', 'frames lose their leading slash, which tf2 refuses: '
                f'{", ".join(dict.fromkeys(slashed))}'))
        keep &= index == largest
        return names[largest]


class TopicCollector:
    """Collects the messages of one topic from one file.

    Attributes
    ----------
    topic, msgtype : name and type.
    count, unreadable : number of messages, and of those that could not be parsed.
    found : their poses, with message indices from the first message on.

    """

    def __init__(self, topic: str, msgtype: str) -> None:
        self.topic, self.msgtype = topic, msgtype
        self.count, self.unreadable = 0, 0
        self.found: list[cdr.Poses] = []
        self._received_ns = [np.zeros(0, np.int64)]
        # The Path used so far: message, its index, and whether it is of ROS 1.
        self._last_path = b'', 0, False

    def add(self, batch: Batch) -> None:
        """Add messages in order of reception."""
        ros1 = batch.channel.encoding == 'ros1'
        self._received_ns.append(np.array(batch.received_ns, dtype=np.int64))
        if self.msgtype == cdr.PATH:
            for k, message in enumerate(batch.messages, self.count):
                self._add_path(message, k, ros1=ros1)
        else:
            found, damaged = cdr.parse_poses(batch.messages, self.msgtype, ros1=ros1)
            self.found += [
                poses._replace(messages=poses.messages + self.count) for poses in found]
            self.unreadable += damaged
        self.count += len(batch.messages)

    def received_ns(self) -> NDArray[np.int64]:
        """Return the receive time of each message, (N,) nanoseconds."""
        return np.concatenate(self._received_ns)

    def tracks(self) -> list[TopicTrack]:
        """Return the tracks for ``join_tracks``; of Paths, one track for each that may be used."""
        groups = [self.found] if self.found else []
        unreadable = self.unreadable
        if self.msgtype == cdr.PATH:
            last = self._parsed_last_path()
            unreadable += last is None and self.count > 0
            groups = [[path] for path in (*self.found, last) if path is not None]
        # The first track has the message counts and no poses.
        tracks = [TopicTrack(self.topic, self.msgtype, self.count, unreadable)]
        for found in groups:
            index, messages, stamps_ns, poses = _joined(found)
            tracks.append(TopicTrack(
                self.topic, self.msgtype, 0, 0, stamps_ns, self.received_ns()[messages], poses,
                index, tuple(item.frames for item in found)))
        return tracks

    def _add_path(self, message: bytes, index: int, *, ros1: bool) -> None:
        """Replace the current path by a newer one.

        A SLAM publishes its whole optimised path repeatedly, and the last one with a usable pose
        is used. Paths grow, so only a shorter one is parsed here. If it starts after the end of
        the current path, both are kept: time or SLAM was restarted.
        """
        if len(message) < len(self._last_path[0]):
            path = cdr.parse_path(message, ros1=ros1)
            if path is None or not _is_usable(path):
                return
            last = self._parsed_last_path()
            if last and len(last.poses) and last.stamps_ns.max() < path.stamps_ns.min():
                self.found.append(last)
        self._last_path = message, index, ros1

    def _parsed_last_path(self) -> cdr.Poses | None:
        message, index, ros1 = self._last_path
        path = cdr.parse_path(message, ros1=ros1)
        return path and path._replace(messages=path.messages + index)


def _joined(found: Sequence[cdr.Poses]) -> list[NDArray[Any]]:
    """Return index in ``found``, message index, stamp and pose of each pose, by message."""
    columns = [np.repeat(np.arange(len(found)), [len(poses.messages) for poses in found]),
               *map(np.concatenate, zip(*(poses[1:] for poses in found), strict=True))]
    order = np.argsort(columns[1], kind='stable')
    return [column[order] for column in columns]


def transform_tree(collectors: Sequence[TopicCollector]) -> TransformTree:
    """Return the tree of the transforms of several topics and files, in order of reception."""
    tree = TransformTree()
    for collector in sorted(collectors, key=lambda item: int(item.received_ns()[0])):
        by_frames: dict[cdr.TwoFrames, list[cdr.Poses]] = {}
        for poses in collector.found:
            by_frames.setdefault(poses.frames, []).append(poses)
        for frames, found in by_frames.items():
            tree.extend(*frames, *_joined(found)[2:], static=collector.topic.endswith('tf_static'))
    return tree


def transform_track(
    name: str, tree: TransformTree, collectors: Sequence[TopicCollector],
) -> TopicTrack:
    """Return the track of ``tf:PARENT.CHILD``.

    Raise TopicError if the two frames are not connected, or do not move relative to each other.
    """
    parent, child = parse_tf(name, tree.frames)
    notes: list[str] = []
    stamps_ns, T = tree.compose(parent, child, notes)
    poses = np.column_stack([T[:, :3, 3], se3.rotation_to_quaternion(T[:, :3, :3])])
    refused = np.sum([link.edge.refused for link in tree.chain(parent, child)], axis=0)
    return TopicTrack(
        name, cdr.TF, sum(item.count for item in collectors),
        sum(item.unreadable for item in collectors), stamps_ns, stamps_ns, poses,
        np.zeros(len(stamps_ns), dtype=np.intp), ((parent, child),),
        refused=tuple(refused.tolist()), notes=tuple(notes))


def _is_usable(path: cdr.Poses) -> bool:
    return not np.all(np.any([path.stamps_ns == 0, *pose_faults(path.poses)], axis=0))


def join_tracks(topic: str, msgtype: str, parts: Sequence[TopicTrack]) -> TopicTrack:
    """Join the tracks of one topic from several files in order of reception."""
    notes = [text for part in parts for text in part.notes]
    ordered = sorted(parts, key=lambda part: part.received_ns[:1].tolist())
    if msgtype == cdr.PATH:
        notes += _dropped_note([part for part in ordered if len(part.poses)])
        ordered = ordered[-1:]
    frames = tuple(dict.fromkeys(pair for part in ordered for pair in part.frames))
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in ordered])
        for name in ('stamps_ns', 'received_ns', 'poses')}
    columns['frame_index'] = np.concatenate([
        np.array([frames.index(pair) for pair in part.frames], np.intp)[part.frame_index]
        for part in ordered])
    return TopicTrack(
        topic, msgtype, sum(part.messages for part in parts),
        sum(part.unreadable for part in parts), frames=frames, notes=tuple(notes), **columns)


def _dropped_note(paths: Sequence[TopicTrack]) -> list[str]:
    """Return a note on dropped paths that do not overlap in time with the last path."""
    if not paths:
        return []
    start, end = paths[-1].stamps_ns.min(), paths[-1].stamps_ns.max()
    separate = [path for path in paths[:-1]
                if path.stamps_ns.max() < start or path.stamps_ns.min() > end]
    if not separate:
        return []
    dropped = counted(len(separate), 'earlier path')
    poses = counted(sum(len(path.poses) for path in separate), 'pose')
    advice = 'only the last path is used; calibrate each bag separately'
    return [f'{dropped} with {poses} of another time: dropped, {advice}']


def _frame_words(frames: tuple[str, str]) -> str:
    return ' -> '.join(repr(name) for name in frames if name) or 'no frame'
