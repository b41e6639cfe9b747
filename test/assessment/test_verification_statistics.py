# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How often ``verify`` and ``fleet`` are right; benchmarks/verification.py has the long form."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.verification import drive, entries, MOVED, verify_seed
from trajectory_calibration import calibrate
from trajectory_calibration.fleet import compare, verify
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.sources.files import FileSource

SCENARIO = replace(SCENARIOS['handheld'], duration=30.0)


@pytest.mark.statistical
def test_a_fresh_drive_holds_and_a_shift_is_noticed():
    counts = {}
    for seed in range(8):
        for name, verdict in verify_seed(SCENARIO, seed).items():
            counts.setdefault(name, Counter())[verdict] += 1
    # In the long form 100 of 100 each; one of eight may be chance, two are not.
    assert counts['same']['holds'] >= 7
    assert counts['3 cm']['moved'] >= 7
    assert counts['0.5 deg']['moved'] >= 7


@pytest.mark.statistical
def test_a_fleet_that_changed_is_named_and_one_that_did_not_agrees():
    T = simulate(SCENARIO, 0).T_a_b
    results = [calibrate(*drive(SCENARIO, seed, T if seed <= 8 else se3.moved(T, MOVED)))
               for seed in range(1, 13)]
    found = compare(entries(results))
    assert found.exit_status == 4
    assert found.describe()[0].startswith('CHANGED: fleet0-7 | fleet8-11: ')
    np.testing.assert_allclose(found.changes[0].step, MOVED, atol=5e-3)
    assert compare(entries(results[:8])).exit_status == 0


@pytest.mark.slow
def test_three_drives_of_one_car_verify_each_other(shared_data):
    drives = []
    for folder in sorted((shared_data / 'real').glob('mulran_*')):
        a, b = (FileSource(folder / f'{name}.tum', sensor_frame=name).load() for name in 'ab')
        drives.append((a, b, calibrate(a, b)))
    assert len(drives) == 3
    for _, _, saved in drives:
        for a, b, result in drives:
            if result is not saved:
                assert verify(saved, a, b).verdict == 'holds'
