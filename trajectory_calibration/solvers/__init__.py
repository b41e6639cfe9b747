"""The solvers: one paper a module, found by name.

A solver is a function ``solve(motions, config) -> Solution`` in the module of its name. It
needs no initial guess, leaves its input untouched, and raises ``MotionError`` for what the
motion does not determine and ``SolverError`` where it finds no minimum.
"""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, TYPE_CHECKING

from trajectory_calibration.errors import ConfigError

if TYPE_CHECKING:
    from trajectory_calibration.config.settings import CalibrationConfig
    from trajectory_calibration.data.motion_pairs import MotionPairs
    from trajectory_calibration.solvers.solution import Solution

SOLVERS = {
    'dnl': 'direct nonlinear least squares (Valimaki et al. 2023)',
    'dnlo': 'the same with outlier rejection (Valimaki et al. 2023)',
    'ali': 'nonlinear, translation rows only (Ali et al. 2019, cost Xc1)',
    'park': 'separable: rotation vectors aligned, then translation (Park et al. 2020)',
    'taylor': 'separable: Kabsch, then translation (Taylor and Nieto 2015)',
    'drift_aware': 'maximum likelihood with white noise, drift and jumps in one model',
    'zhuang': 'Gauss-Newton in z = tan(w/2) k (Zhuang and Qu 1994)',
}
SOLVER_NAMES = tuple(SOLVERS)

# They work on the pose pairs themselves: a reference changes only the relative errors reported.
WITHOUT_REFERENCE = frozenset({'drift_aware'})


class Solver(Protocol):
    """What every solver module offers under the name ``solve``."""

    def __call__(self, motions: MotionPairs, config: CalibrationConfig) -> Solution:
        """Return the extrinsic that the motions determine."""
        ...


def load_solver(name: str) -> Solver:
    """Return the solver of that name; its module, and CasADi where it needs it, load now.

    Raises
    ------
    ConfigError
        An unknown name; the message lists the valid ones.

    """
    if name not in SOLVERS:
        raise ConfigError(f'solver {name!r} is unknown; needed one of {", ".join(SOLVERS)}')
    solver: Solver = import_module(f'{__name__}.{name}').solve
    return solver
