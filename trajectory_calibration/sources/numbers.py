# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Decimal numbers out of the lines of a table, as ``float`` reads them; times without rounding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray

_INT64_MAX = 2**63 - 1


class NotANumberError(ValueError):
    """A field is no number, or a time that does not fit: ``args`` are row, column, reason."""


class Numbers(NamedTuple):
    """Some columns of a table.

    Attributes
    ----------
    values : (N, K) numbers of K columns.
    stamps_ns : (N,) times of one more column, 0 where not finite.
    places : (N,) digits of the times after the point, less the exponent.
    finite, exact : (N,) whether a time is a number, and one of whole nanoseconds.

    """

    values: FloatArray
    stamps_ns: NDArray[np.int64]
    places: NDArray[np.intp]
    finite: NDArray[np.bool_]
    exact: NDArray[np.bool_]


def read_columns(
    lines: list[str], separator: str | None, width: int, columns: Sequence[int],
    time_column: int | None = None, decimals: int = 0,
) -> Numbers:
    """Return the numbers of some columns, and the exact times of another one.

    Parameters
    ----------
    lines : list of str
        Rows of a table.
    separator : str
        A comma, or None for blanks.
    width : int
        How many fields a line has.
    columns : sequence of int
        Which columns.
    time_column : int, optional
        The one with the time.
    decimals : int
        Its unit is 10^-decimals s.

    Raises
    ------
    NotANumberError
        A field is no number, or a time is out of range.
    ValueError
        A line has more fields or fewer.

    """
    kinds = ['U1'] * width
    for column in columns:
        kinds[column] = 'f8'
    if time_column is not None:
        kinds[time_column] = 'O'
    try:
        table = np.loadtxt(lines, np.dtype([('', kind) for kind in kinds]), comments=None,
                           delimiter=separator, ndmin=1)
    except ValueError:
        for row, line in enumerate(lines):
            fields = line.split(separator)
            for column in columns:
                if len(fields) == width and not is_number(fields[column]):
                    raise NotANumberError(row, column, 'is no number') from None
        raise
    values = np.empty((len(lines), len(columns)))
    for k, column in enumerate(columns):
        values[:, k] = table[f'f{column}']
    if time_column is None:
        nothing = np.zeros(0, dtype=np.int64)
        return Numbers(values, nothing, nothing, nothing > 0, nothing > 0)
    return Numbers(values, *_times(table[f'f{time_column}'].tolist(), 9 - decimals, time_column))


def is_number(word: str) -> bool:
    """Tell whether a word is a number as other languages write it too."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and '_' not in word


def _times(words: list[str], exponent: int, column: int) -> tuple[
        NDArray[np.int64], NDArray[np.intp], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return numbers times 10^exponent, rounded half to even, and what ``Numbers`` has of them."""
    scaled, places = [], []
    finite, exact = np.ones((2, len(words)), dtype=bool)
    for row, word in enumerate(words):
        whole, _, fraction = word.partition('.')
        if len(fraction) <= exponent and (whole + fraction).isdecimal():
            scaled.append(int(whole + fraction.ljust(exponent, '0')))
            places.append(len(fraction))
            continue
        if not is_number(word):
            raise NotANumberError(row, column, 'is no number')
        from decimal import Decimal
        try:
            number = Decimal(word.strip()).scaleb(exponent)
            scaled.append(round(number))
            places.append(exponent - int(number.as_tuple().exponent))
            exact[row] = number == scaled[-1]
        except (ArithmeticError, ValueError):
            # Not finite, or an exponent that no decimal has.
            finite[row] = False
            scaled.append(0)
            places.append(0)
    try:
        return np.array(scaled, np.int64), np.array(places, np.intp), finite, exact
    except OverflowError:
        row = next(row for row, time in enumerate(scaled) if abs(time) > _INT64_MAX)
        raise NotANumberError(row, column, 'is out of range, the years 1678 to 2262') from None
