# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers read a block at a time are those that Python reads one by one."""

from decimal import Decimal
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration.sources.numbers import NotANumberError, read_columns
from trajectory_calibration.sources.text import Table

DIGITS = st.text('0123456789', max_size=21)


@st.composite
def decimals(draw):
    """Return a number as somebody may write it."""
    whole, fraction = draw(DIGITS), draw(st.none() | DIGITS)
    if not whole and not fraction:
        whole = '0'
    text = draw(st.sampled_from(['', '-', '+'])) + whole
    text += '' if fraction is None else f'.{fraction}'
    if draw(st.booleans()):
        text += draw(st.sampled_from('eE')) + draw(st.sampled_from(['', '-', '+']))
        text += draw(st.sampled_from(['0', '00', '7', '09', '12', '022', '40']))
    return text


NUMBERS = (decimals() | st.floats().map(repr) | st.floats(-1e3, 1e3).map('{:.9f}'.format)
           | st.floats(-1e3, 1e3).map('{:.18e}'.format) | st.sampled_from(['nan', '-inf']))


@settings(max_examples=100, deadline=None)
@given(st.lists(NUMBERS, min_size=3, max_size=3 * 8).map(lambda x: x[:len(x) // 3 * 3]))
def test_floats_are_those_of_python(words):
    rows = [words[k:k + 3] for k in range(0, len(words), 3)]
    expected = [[float(word) for word in row] for row in rows]
    values = read_columns([*map(' '.join, rows)], None, 3, [0, 1, 2]).values
    np.testing.assert_array_equal(values, expected)
    values = read_columns([*map(' , '.join, rows)], ',', 3, [2, 0]).values
    np.testing.assert_array_equal(values, np.array(expected)[:, [2, 0]])


@settings(max_examples=100, deadline=None)
@given(st.lists(decimals(), min_size=1, max_size=5), st.sampled_from([0, 3, 6, 9]))
def test_times_are_exact(words, unit):
    exact = [round(Decimal(word).scaleb(9 - unit)) for word in words]
    if max(map(abs, exact)) >= 2**63:
        with pytest.raises(NotANumberError, match='out of range'):
            read_columns(words, None, 1, [], 0, unit)
    else:
        assert read_columns(words, None, 1, [], 0, unit).stamps_ns.tolist() == exact


@pytest.mark.parametrize('word', [
    'x', '1.2.3', '1-2', '--1', '1e', 'e5', '1e5e5', '1_0', '.', '-', '+', '1e+-3', '0x10', '1..2',
    '1e5.0', '1:2', '1/2', '1d3', '\xe9'])
@pytest.mark.parametrize('separator', [' ', ','])
def test_what_is_no_number(word, separator):
    rows = [['1', '2.5'], ['3', word], ['5', '6']]
    lines = [*map(separator.join, rows)]
    for columns, time in (([0, 1], None), ([0], 1)):
        with pytest.raises(NotANumberError) as caught:
            read_columns(lines, separator.strip() or None, 2, columns, time)
        assert caught.value.args == (1, 1, 'is no number')


def test_lines_of_unequal_length():
    for lines, separator in ((['1 2 3', '4 5', '6 7 8'], None), (['1,2,3', '4,5'], ',')):
        with pytest.raises(ValueError, match='columns'):
            read_columns(lines, separator, 3, [0, 1])


def test_fields_that_are_empty_or_blank_keep_their_place():
    table = Table.parse(Path('x'), '1, ,,a b,5,\n6,,7,, 8 ,\n')
    assert (len(table.line_numbers), table.width) == (2, 5)
    np.testing.assert_array_equal(table.read_numbers([0, 4]).values, [[1, 5], [6, 8]])
    np.testing.assert_array_equal(table.sample()[0], [1, np.nan, np.nan, np.nan, 5])


def test_digits_after_the_point():
    numbers = read_columns(['12.034', '7', '5.', '-1.5', '1.25e3', 'nan'], None, 1, [], 0)
    assert numbers.places.tolist() == [3, 0, 0, 1, -1, 0]
    assert numbers.finite.tolist() == [True] * 5 + [False]
    numbers = read_columns(['7', '7.0', '7.5'], None, 1, [], 0, 9)
    assert numbers.exact.tolist() == [True, True, False]
