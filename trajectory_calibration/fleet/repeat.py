"""``benchmark repeat``: many bags of the same two sensors, each calibrated by itself.

How far the answers scatter is the accuracy that no single bag can tell.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import CalibrationError, MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.pipeline import calibrate


@dataclass(frozen=True)
class BagTask:
    """One bag, its two topics, and how to calibrate."""

    bag: Path
    topic_a: str
    topic_b: str
    config: CalibrationConfig = field(default_factory=CalibrationConfig)


@dataclass(frozen=True)
class BagRecord:
    """The answer of one bag. The fields are the columns of the results file.

    The pose of b in a: metres and a quaternion; NaN where there is no answer, and ``note`` then
    says why. ``unobserved`` names the degrees of freedom that neither the motion nor a prior
    determines, with commas between: the answer has numbers there that say nothing. ``warnings``
    are those of the result, with semicolons between.
    """

    bag: str
    x_m: float = float('nan')
    y_m: float = float('nan')
    z_m: float = float('nan')
    qx: float = float('nan')
    qy: float = float('nan')
    qz: float = float('nan')
    qw: float = float('nan')
    motions: int = 0
    e_rt_m: float = float('nan')
    e_rR_deg: float = float('nan')
    unobserved: str = ''
    warnings: str = ''
    note: str = ''

    @property
    def T_a_b(self) -> FloatArray:
        """Return the (4, 4) pose of b in a."""
        return se3.from_rotation_translation(
            se3.quaternion_to_rotation([self.qx, self.qy, self.qz, self.qw]),
            [self.x_m, self.y_m, self.z_m])


@dataclass(frozen=True, eq=False)
class Scatter:
    """How the answers of several bags scatter.

    Attributes
    ----------
    T_a_b : (4, 4), their mean.
    std_m : (3,) standard deviations along x, y, z of a, metres.
    std_deg : (3,) standard deviations of the rotation about x, y, z of a, degrees.

    """

    T_a_b: FloatArray
    std_m: FloatArray
    std_deg: FloatArray


def calibrate_bag(task: BagTask) -> BagRecord:
    """Calibrate one bag; a bag that gives no answer gives the reason."""
    # The bag library loads where a bag is read, and only there.
    from trajectory_calibration.sources.bags import open_bags
    topics = task.topic_a, task.topic_b
    try:
        with open_bags([task.bag]) as reader:
            tracks = reader.read(topics)
        a, b = (tracks[topic].to_trajectory() for topic in topics)
        result = calibrate(a, b, task.config)
    except CalibrationError as error:
        return BagRecord(str(task.bag), note=' '.join(str(error).split()))
    x, y, z = result.T_a_b[:3, 3].tolist()
    qx, qy, qz, qw = se3.rotation_to_quaternion(result.T_a_b[:3, :3]).tolist()
    return BagRecord(
        str(task.bag), x, y, z, qx, qy, qz, qw, result.motions, result.metrics.e_rt,
        float(np.rad2deg(result.metrics.e_rR)), ', '.join(result.observability.unobserved),
        '; '.join(result.warnings))


def scatter(records: Sequence[BagRecord]) -> Scatter:
    """Return the scatter of the answers.

    Raises
    ------
    MotionError
        Fewer than two bags gave an answer.

    """
    found = np.array([record.T_a_b for record in records if not record.note])
    if len(found) < 2:
        raise MotionError(
            f'{len(found)} of {len(records)} bags gave an answer, needed at least 2 to compare; '
            'see what each of them lacks with inspect')
    R = se3.nearest_rotation(found[:, :3, :3].mean(axis=0))
    turned = se3.log_so3(found[:, :3, :3] @ R.T)
    return Scatter(
        se3.from_rotation_translation(R, found[:, :3, 3].mean(axis=0)),
        found[:, :3, 3].std(axis=0, ddof=1), np.rad2deg(turned.std(axis=0, ddof=1)))


def describe_open(records: Sequence[BagRecord]) -> str:
    """Say which degrees of freedom how many of the answers leave open; empty where none does."""
    answers = [record.unobserved.split(', ') for record in records if not record.note]
    counts = Counter(name for names in answers for name in names if name)
    if not counts:
        return ''
    found = ', '.join(f'{name} in {count}' for name, count in counts.items())
    return (f'not observed: {found} of {len(answers)} bags; along what is not observed the '
            'scatter is no accuracy: leave these bags out, or give a prior')
