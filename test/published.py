# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's published trajectories and figures, in the form that the tests compare."""

from functools import lru_cache

from benchmarks.paper import published
from benchmarks.paper.published import SEQUENCES

__all__ = [
    'REFERENCES',
    'SEQUENCES',
    'kitti',
    'kitti_figures',
    'simulation_figures',
    'simulations',
]

REFERENCES = ['B1', 'B5', 'B10', 'C5', 'C10']

_E_AT, _E_AR = (published.ERRORS.index(name) for name in ('e_at_m', 'e_aR_deg'))


@lru_cache
def kitti(data, sequence):
    """Return trajectories a and b and the truth of a sequence, as the paper used them."""
    drive = published.read_kitti(data, sequence)
    return drive.a, drive.b, drive.T_a_b_file


def simulations(data, every=1, cases=None):
    """Yield kind, level (None for the mixture), run, trajectories a and b, truth.

    Of one run in ``every``, the same ones of each kind and level; of these ``cases``, pairs of
    kind and level, or of all.
    """
    items = published.simulation_runs(data)
    kept = set(sorted({item.run for item in items})[::every])
    for item in items:
        case = item.kind, _level(item.kind, item.level)
        if item.run in kept and (cases is None or case in cases):
            yield *case, item.run, *item.load()


def kitti_figures(data):
    """Return (e_at metres, e_aR degrees) by sequence, solver, reference."""
    return {key: (errors[_E_AT], errors[_E_AR])
            for key, errors in published.kitti_figures(data).items()}


def simulation_figures(data):
    """Return lists of (e_at metres, e_aR degrees) by kind, level, solver, reference."""
    figures = {}
    for (kind, level, _, *rest), errors in published.simulation_figures(data).items():
        figures.setdefault((kind, _level(kind, level), *rest), []).append(
            (errors[_E_AT], errors[_E_AR]))
    return figures


def _level(kind, level):
    return None if kind == 'mixture' else level
