# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every setting of a calibration: its default, its range and its meaning.

The command line, the node's parameters and ``config/calibration.yaml`` derive from the fields
of ``CalibrationConfig``: no default is written twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from math import inf
from numbers import Integral, Real
from typing import Any, ClassVar

from trajectory_calibration.config.prior import parse_prior, Prior
from trajectory_calibration.data.motion_pairs import normal_reference, REFERENCE_HELP
from trajectory_calibration.data.pose_pairs import METHODS
from trajectory_calibration.errors import ConfigError, unknown_name
from trajectory_calibration.solvers import (
    DEFAULT_SOLVER,
    solver_info,
    SOLVER_NAMES,
    solvers_that_estimate,
)


@dataclass(frozen=True)
class Option:
    """One field of a configuration, for the command line and the node.

    ``help`` is one sentence with the unit. A number has a closed range, a word has choices;
    other packages can add choices if it is ``extensible``.
    """

    name: str
    default: Any
    help: str
    minimum: float = -inf
    maximum: float = inf
    choices: tuple[str, ...] = ()
    extensible: bool = False

    @property
    def kind(self) -> type:
        """Return str, float, int or bool: the type of the default."""
        return type(self.default)

    def check(self, value: Any) -> Any:
        """Return the value in this option's type; raise ConfigError if it does not fit.

        NumPy numbers become Python numbers. A number given for a text becomes its text: YAML
        and ROS read a typed '0.01' as a number.
        """
        # A longer integer fits no float, and Python refuses to print it.
        if isinstance(value, int) and value.bit_length() > 1000:
            raise ConfigError(f'{self.name} is an integer of too many digits')
        kinds: Any = {float: Real, int: Integral, str: (str, Real)}.get(self.kind, ())
        if isinstance(value, kinds) and not isinstance(value, bool):
            value = self.kind(value)
        if type(value) is not self.kind:
            raise ConfigError(
                f'{self.name} is {value!r}, needed a value of type {self.kind.__name__}')
        if self.choices and not self.extensible and value not in self.choices:
            raise ConfigError(
                f'{self.name} {value!r} is unknown; needed one of {", ".join(self.choices)}')
        # Written so that NaN fails.
        if isinstance(value, (int, float)) and not self.minimum <= value <= self.maximum:
            raise ConfigError(
                f'{self.name} is {value}, needed {self.minimum:g} to {self.maximum:g}')
        return value


def _option(default: Any, text: str, *limits: float, **words: Any) -> Any:
    return field(default=default, metadata={'option': (default, text, *limits), 'words': words})


# Names for the help texts.
_SCALE_SOLVERS, _DRIFT_SOLVERS = (
    ' or '.join(solvers_that_estimate(term)) for term in ('scale', 'systematic_drift'))

# Modes of the terms beside the extrinsic: time offset, scale, systematic drift.
MODES = ('fixed', 'estimate', 'auto')
_MODES = 'estimate: always estimated; auto: estimated if significant'


@dataclass(frozen=True)
class CalibrationConfig:
    """How to calibrate. Every default of the package lives here.

    Raises
    ------
    ConfigError
        A value of the wrong type or out of its range, with the range in the message.

    """

    solver: str = _option(
        DEFAULT_SOLVER, 'calibration method', choices=SOLVER_NAMES, extensible=True)
    reference: str = _option('auto', f'reference pose of each motion: {REFERENCE_HELP}')
    association: str = _option(
        'auto', 'how poses of a and b are paired in time. interpolate: a is interpolated at the '
        'stamps of b; nearest: no interpolation; auto: the sensor with more poses a second is '
        'interpolated, unless most stamps coincide', choices=METHODS)
    max_gap: float = _option(
        0.5, 'longest gap between two poses that are interpolated, seconds', 0.0, 3600.0)
    max_time_difference: float = _option(
        0.02, 'largest time between the two poses of a pair with nearest, seconds',
        0.0, 3600.0)
    time_offset: float = _option(
        0.0, 'added to the stamps of b, seconds; where the search starts, unless '
        'time_offset_mode is fixed', -4e9, 4e9)
    time_offset_mode: str = _option(
        'auto', f'fixed: time_offset is used; {_MODES}. Unless fixed, clock drift is corrected, '
        'too', choices=MODES)
    max_time_offset: float = _option(
        5.0, 'the search goes this far from time_offset, seconds; 0: no search', 0.0, 3600.0)
    scale: float = _option(
        1.0, 'metres of a per metre of b; the positions of b are multiplied by it', 1e-6, 1e6)
    scale_mode: str = _option(
        'auto', f'fixed: scale is used; {_MODES}, unless scale is not 1. Only {_SCALE_SOLVERS} '
        'estimates it', choices=MODES)
    systematic_drift_mode: str = _option(
        'auto', 'constant drift of b per metre along its axes. fixed: none; '
        f'{_MODES}. Only {_DRIFT_SOLVERS} estimates it', choices=MODES)
    dnlo_c: float = _option(
        0.01, 'cost c of rejecting a motion (dnlo): a motion with a larger squared residual is an '
        'outlier', 0.0, 1e6)
    dnlo_min_inliers: float = _option(
        0.5, 'smallest share d of the motions that dnlo keeps', 0.0, 1.0)
    dnlo_method: str = _option(
        'auto', 'how dnlo minimises; auto chooses by the number of motions',
        choices=('auto', 'ipopt', 'path', 'alternating'))

    prior_translation: str = _option(
        '', 'known position of b in a, metres: x,y,z with - for unknown')
    prior_translation_std: str = _option(
        '', 'standard deviations of prior_translation, metres: one number, or x,y,z; 0 fixes a '
        'component')
    prior_rotation: str = _option(
        '', 'known orientation of b in a, degrees: roll,pitch,yaw as in URDF')
    prior_rotation_std: str = _option(
        '', 'standard deviations of prior_rotation about x,y,z of a, degrees: one number, or '
        'three with - for unknown; 0 fixes a component')
    allow_unobserved: bool = _option(
        default=False, text='publish and export results with unobservable directions, too; these '
        'stay marked')
    weak_translation: float = _option(
        0.05, 'standard deviation above which a direction of the translation is weak, '
        'metres', 0.0, 1e3)
    weak_rotation: float = _option(
        0.5, 'standard deviation above which a direction of the rotation is weak, degrees',
        0.0, 180.0)
    unobserved_translation: float = _option(
        0.5, 'standard deviation above which a direction of the translation is unobservable '
        '(shown as unknown), metres', 0.0, 1e3)
    unobserved_rotation: float = _option(
        5.0, 'standard deviation above which a direction of the rotation is unobservable '
        '(shown as unknown), degrees', 0.0, 180.0)

    # Settings of a saved result that this version does not know.
    _unknown: ClassVar[Mapping[str, Any]] = {}

    input_checks: bool = _option(
        default=True, text='refuse trajectories that cannot be of one vehicle: inverted poses, '
        'another order of quaternions, two vehicles, no orientation')

    def __post_init__(self) -> None:
        for option in self.options():
            object.__setattr__(self, option.name, option.check(getattr(self, option.name)))
        object.__setattr__(self, 'reference', normal_reference(self.reference))
        info = solver_info(self.solver)
        for term in ('scale', 'systematic_drift'):
            if self.mode(term) == 'estimate' and term not in info.estimates:
                raise ConfigError(
                    f'{term}_mode is estimate, which {self.solver} cannot; use solver '
                    f'{" or ".join(solvers_that_estimate(term))}, or set it to fixed')
        if self.time_offset_mode == 'estimate' and self.max_time_offset == 0:
            raise ConfigError('time_offset_mode is estimate and max_time_offset 0, needed more '
                              'than 0 seconds to look in, or time_offset_mode fixed')
        # Parsed now: a mistake shows before any data is loaded.
        _ = self.prior

    def mode(self, term: str) -> str:
        """Return 'fixed', 'estimate' or 'auto' for 'time_offset', 'scale', 'systematic_drift'.

        With 'auto', a given scale is 'fixed', and so is the time offset if there is no search.
        A given time offset is only the start of the search.
        """
        mode: str = getattr(self, f'{term}_mode')
        known = {'scale': self.scale != type(self).scale,
                 'time_offset': self.max_time_offset == 0}
        return 'fixed' if mode == 'auto' and known.get(term, False) else mode

    @property
    def prior(self) -> Prior:
        """Return the prior of the extrinsic."""
        return parse_prior(self.prior_translation, self.prior_translation_std,
                           self.prior_rotation, self.prior_rotation_std)

    @classmethod
    def options(cls) -> Iterator[Option]:
        """Yield every field with its type, default, help and limits."""
        for item in fields(cls):
            yield Option(item.name, *item.metadata['option'], **item.metadata['words'])

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> CalibrationConfig:
        """Build a configuration from names and values; unknown names raise ConfigError."""
        known = [option.name for option in cls.options()]
        for name in values:
            if name not in known:
                raise ConfigError(unknown_name('setting', name, known))
        return cls(**values)

    @classmethod
    def from_saved(cls, values: Mapping[str, Any]) -> CalibrationConfig:
        """Rebuild the configuration of a saved result, also of one from other packages.

        Settings, solvers and words that are unknown here are kept unchanged; ``from_dict``
        refuses them before another calibration. Raises ConfigError for numbers out of range and
        values of the wrong type.
        """
        config = cls()
        options = {option.name: option for option in cls.options()}
        for name, value in values.items():
            option = options.get(name)
            if option is not None:
                is_word = bool(option.choices) and isinstance(value, str)
                object.__setattr__(config, name, value if is_word else option.check(value))
        object.__setattr__(config, '_unknown', {
            name: value for name, value in values.items() if name not in options})
        _ = config.prior
        return config

    def to_dict(self) -> dict[str, Any]:
        """Return names and values, ready for YAML or JSON."""
        return {**asdict(self), **self._unknown}
