"""What a solver returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.se3 import FloatArray


@dataclass(frozen=True, eq=False)
class Solution:
    """An extrinsic and how it was found.

    Attributes
    ----------
    T_a_b : (4, 4), the pose of sensor b in sensor a.
    cost : the solver's own cost at the answer, in the units of its module's formula.
    iterations : iterations of the start that won.
    inliers : (M,) bool, the motions that the solver kept, or None where it rejects none.
    covariance : (6, 6) or None; order and side as in ``CalibrationResult``.
    warnings : sentences for the result.

    """

    T_a_b: FloatArray
    cost: float
    iterations: int
    inliers: NDArray[np.bool_] | None = None
    covariance: FloatArray | None = None
    warnings: tuple[str, ...] = ()
