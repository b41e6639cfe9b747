# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""From two trajectories to pose pairs, by the settings: clock alignment, then association."""

from __future__ import annotations

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.plausibility import doubts_of_both
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import AssociationError
from trajectory_calibration.time_alignment.clock_offset import ClockCorrection, synchronise
from trajectory_calibration.time_alignment.pairing import associate


def match(
    a: Trajectory, b: Trajectory, config: CalibrationConfig,
) -> tuple[ClockCorrection, PosePairs]:
    """Return the clock correction of b and the pose pairs.

    Raise AssociationError as ``synchronise`` and ``associate``, with a question if the stamps may
    be in another unit.
    """
    try:
        clock = synchronise(
            a, b, config.time_offset, config.mode('time_offset'), config.max_time_offset)
        b_on_time = b.retimed(clock.drift, clock.drift_from_ns)
        return clock, associate(a, b_on_time, config, round(clock.offset_s * 1e9))
    except AssociationError as error:
        doubts = doubts_of_both(a, b)
        if not doubts:
            raise
        # The question comes first: an offset or a longer gap would only hide a wrong unit.
        raise AssociationError(f'{"; ".join(map(str, doubts))}; {error}') from error
