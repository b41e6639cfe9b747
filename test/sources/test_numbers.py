# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers read a block at a time are those that Python reads one by one."""

from decimal import Decimal

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration.sources.numbers import Fields, NotANumberError

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
    fields = Fields.separated_by_space('\n'.join(map(' '.join, rows)).encode())
    np.testing.assert_array_equal(fields.read([0, 1, 2])[0], expected)
    fields = Fields.separated_by_commas('\n'.join(map(' , '.join, rows)).encode() + b'\n')
    np.testing.assert_array_equal(fields.read([2, 0])[0], np.array(expected)[:, [2, 0]])


@settings(max_examples=100, deadline=None)
@given(st.lists(decimals(), min_size=1, max_size=5), st.sampled_from([0, 3, 6, 9]))
def test_times_are_exact(words, unit):
    exact = [round(Decimal(word).scaleb(9 - unit)) for word in words]
    fields = Fields.separated_by_space('\n'.join(words).encode())
    if max(map(abs, exact)) >= 2**63:
        with pytest.raises(NotANumberError, match='out of range'):
            fields.read([0], 0, unit)
    else:
        assert fields.read([0], 0, unit)[1].tolist() == exact


@pytest.mark.parametrize('word', [
    'x', '1.2.3', '1-2', '--1', '1e', 'e5', '1e5e5', '1_0', '.', '-', '+', '1e+-3', '0x10', '1..2',
    '1e5.0', '1:2', '1/2', '1d3', '\xe9'])
@pytest.mark.parametrize('read', [Fields.separated_by_space, Fields.separated_by_commas])
def test_what_is_no_number(word, read):
    separator = ' ' if read == Fields.separated_by_space else ','
    rows = [['1', '2.5'], ['3', word], ['5', '6']]
    fields = read('\n'.join(map(separator.join, rows)).encode())
    with pytest.raises(NotANumberError) as caught:
        fields.read([0, 1])
    assert caught.value.args == (1, 1, 'is no number')
    assert fields.word(1, 1) == word


def test_lines_of_unequal_length():
    assert Fields.separated_by_space(b'1 2 3\n4 5\n6 7 8').tolist() == [3, 2, 3]
    assert Fields.separated_by_commas(b'1,2,3\n4,5\n').tolist() == [3, 2]


def test_fields_that_are_empty_or_blank_keep_their_place():
    fields = Fields.separated_by_commas(b'1, ,,a b,5,\r\n6,,7,, 8 ,\r\n')
    assert (len(fields), fields.width) == (2, 5)
    assert [fields.word(0, k) for k in range(5)] == ['1', '', '', 'a b', '5']
    np.testing.assert_array_equal(fields.read([0, 4])[0], [[1, 5], [6, 8]])


def test_digits_after_the_point():
    fields = Fields.separated_by_space(b'12.034\n7\n5.\n-1.5\n1.25e3\n')
    assert fields.read([0], 0).places.tolist() == [3, 0, 0, 1, -1]
