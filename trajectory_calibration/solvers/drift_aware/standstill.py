"""Poses of a vehicle at rest, most of which are left out where drift makes them worthless.

Rotation noise of a moves b by the lever arm. A pose at rest shows that noise and little else, so
that a shorter lever arm fits it better: the error of least squares with noise in the derivatives
(W. A. Fuller, "Measurement Error Models", 1987). Without drift it does not matter, because a
thousand poses at rest say a thousand times as much of where the sensors are. Where what drifts
from one stop to the next is more than the noise of a single pose, they say no more than a few,
and minutes of rest outweigh the drive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.fit import Fit

# What moves less within this long before and after a pose, seconds, than this share of what is
# usual while it moves, is at rest; a pose each so many seconds is kept of it.
_AROUND_S = 0.5
_STILL = 0.1
_KEPT_S = 5.0

# Where fewer poses than this would be left, all of them stay.
_FEWEST = 50

# The largest motions, which may be jumps, do not say what is usual.
_TRIMMED = 0.01


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive without most of its poses at rest.

    Attributes
    ----------
    pairs : those that are left.
    stops : stretches of rest that were thinned.

    """

    pairs: PosePairs
    stops: int

    def rest_is_worthless(self, fit: Fit) -> bool:
        """Tell from a fit to the pairs that are left whether the others would tell nothing."""
        noise = fit.noise
        drifted = 1 / noise.walk_precision(noise.walk_parts().sum(axis=0))[:, 0]
        # Of both sensors, as the walk.
        return bool(drifted.sum() > 2 * noise.variances[0] * self.stops)


def without_rest(pairs: PosePairs) -> Drive:
    """Leave out most of the pairs between which neither sensor moved."""
    step_ns = float(np.median(np.diff(pairs.stamps_ns)))
    reach = max(1, round(_AROUND_S * 1e9 / step_ns))
    k = np.arange(len(pairs))
    before, after = np.maximum(k - reach, 0), np.minimum(k + reach, len(k) - 1)
    rest = np.ones(len(k), bool)
    for poses in (pairs.poses_a, pairs.poses_b):
        change = poses[after, :3] - poses[before, :3]
        for moved in (np.linalg.norm(change[:, :, 3], axis=1),
                      np.linalg.norm(change[:, :, :3], axis=(1, 2))):
            rest &= moved < _STILL * _usual(moved)
    period = (pairs.stamps_ns - pairs.stamps_ns[0]) // round(_KEPT_S * 1e9)
    kept = ~rest | (np.diff(period, prepend=-1) > 0)
    if kept.all() or np.count_nonzero(kept) < _FEWEST:
        return Drive(pairs, 0)
    return Drive(pairs.picked(kept), int(np.count_nonzero(np.diff(rest, prepend=False) & rest)))


def _usual(moved: FloatArray) -> float:
    """Return the one of (n,) moves at which half of the way is behind, however long the rest."""
    ascending = np.sort(moved)[:max(1, round((1 - _TRIMMED) * len(moved)))]
    way = np.cumsum(ascending)
    return float(ascending[np.searchsorted(way, 0.5 * way[-1])])
