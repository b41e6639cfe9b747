# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Statistics in two lengths: a few cases in ``make test``, all of them in ``make test-all``."""

import pytest


def thinned(name, few, many):
    """Parametrize ``name`` by ``few``, and by ``many`` where tests may take minutes."""
    return pytest.mark.parametrize(
        name, [few, pytest.param(many, marks=pytest.mark.slow)], ids=['few', 'many'])


def but_slow(cases, kept):
    """Return the cases for ``parametrize``; those that are not kept may take minutes."""
    return [case if case in kept else pytest.param(*case, marks=pytest.mark.slow)
            for case in cases]
