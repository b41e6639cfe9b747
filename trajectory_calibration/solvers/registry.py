# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The registry of solvers: what each needs and what it estimates.

Pipeline, settings and reference selection read these rows and contain no solver names. Another
package adds rows through the entry point group ``trajectory_calibration.solvers``;
``docs/add_a_solver.md`` has an example.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pkgutil import resolve_name
from typing import Any, cast, TYPE_CHECKING

from trajectory_calibration.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = 'trajectory_calibration.solvers'
DEFAULT_SOLVER = 'drift_aware'

# Parameters besides the extrinsic that a solver may estimate; each has a ..._mode setting.
TERMS = ('scale', 'systematic_drift', 'time_offset')


@dataclass(frozen=True)
class SolverInfo:
    """A solver and its capabilities.

    Attributes
    ----------
    name : as in the setting ``solver``.
    sentence : a description, for the list of solvers.
    function : the solver (``solution.Solver``), or its 'module:name', imported on first use.
    needs_reference : whether it uses relative motions to a reference. If not, it uses the pose
        pairs, and the reference only changes the reported residuals.
    estimates : which of ``TERMS`` it can estimate.
    identifies_noise : whether it identifies the noise of the data; such a solver provides the
        covariance of the others and selects their reference.

    """

    name: str
    sentence: str
    function: str | Callable[..., Any]
    needs_reference: bool = True
    estimates: frozenset[str] = frozenset()
    identifies_noise: bool = False

    def load(self) -> Callable[..., Any]:
        """Return the function; imports its module, and CasADi if it needs it."""
        if not isinstance(self.function, str):
            return self.function
        return cast('Callable[..., Any]', resolve_name(self.function))


_HERE = __name__.rpartition('.')[0]
_ROWS = (
    SolverInfo('dnl', 'direct nonlinear least squares (Valimaki et al. 2023)',
               f'{_HERE}.dnl:solve'),
    SolverInfo('dnlo', 'the same with outlier rejection (Valimaki et al. 2023)',
               f'{_HERE}.dnlo:solve'),
    SolverInfo('ali', 'nonlinear, translation rows only (Ali et al. 2019, cost Xc1)',
               f'{_HERE}.ali:solve'),
    SolverInfo('park', 'separable: rotation vectors aligned, then translation (Park et al. 2020)',
               f'{_HERE}.separable:solve'),
    SolverInfo('taylor', 'separable: Kabsch, then translation (Taylor and Nieto 2015)',
               f'{_HERE}.separable:solve'),
    SolverInfo('drift_aware', 'maximum likelihood with white noise, drift and jumps in one model',
               f'{_HERE}.drift_aware:solve', needs_reference=False, estimates=frozenset(TERMS),
               identifies_noise=True),
    SolverInfo('zhuang', 'Gauss-Newton in z = tan(w/2) k (Zhuang and Qu 1994)',
               f'{_HERE}.zhuang:solve'),
)
SOLVER_NAMES = tuple(row.name for row in _ROWS)


def solver_info(name: str) -> SolverInfo:
    """Return the row of a solver; raise ConfigError, with the valid names, for an unknown one."""
    for row in _ROWS:
        if row.name == name:
            return row
    others = _of_other_packages()
    if name not in others:
        raise ConfigError(
            f'solver {name!r} is unknown; needed one of {", ".join((*SOLVER_NAMES, *others))}')
    return _row(others[name])


def solvers() -> tuple[SolverInfo, ...]:
    """Return the rows of all installed solvers."""
    return (*_ROWS, *map(_row, _of_other_packages().values()))


def load_solver(name: str) -> Callable[..., Any]:
    """Return the solver of that name; raises as ``solver_info``."""
    return solver_info(name).load()


def solvers_that_estimate(term: str) -> tuple[str, ...]:
    """Return the names of this package's solvers that can estimate one of ``TERMS``."""
    return tuple(row.name for row in _ROWS if term in row.estimates)


def noise_identifier() -> SolverInfo:
    """Return the solver that identifies the noise."""
    return next(row for row in _ROWS if row.identifies_noise)


def _of_other_packages() -> dict[str, EntryPoint]:
    # Imported here: it reads the metadata of every installed package.
    from importlib.metadata import entry_points
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def _row(entry: EntryPoint) -> SolverInfo:
    """Return the row behind an entry point: a ``SolverInfo``, or the function of a solver."""
    found = entry.load()
    if isinstance(found, SolverInfo):
        return replace(found, name=entry.name)
    sentence = (found.__doc__ or f'of {entry.value}').strip().splitlines()[0]
    return SolverInfo(entry.name, sentence, found)
