# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The schemas of RIG.yaml and of a saved rig describe what is read and written."""

import json

import pytest
from schemas import validator

from benchmarks.simulated_rig import Fault, RigScenario, simulate_rig
from trajectory_calibration import calibrate, ConfigError
from trajectory_calibration.config.yaml_file import read_yaml
from trajectory_calibration.rig import calibrate_rig, fuse_results, RigConfig, SensorSettings
from trajectory_calibration.rig.description import (
    _KEYS,
    _KNOWN_OF_SENSOR,
    _READING,
    _SOURCES,
    RigDescription,
)
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import flat, Unicycle
from trajectory_calibration.simulation.scenario import Sensor

SLAM = Noise(white=0.005, white_rotation=0.0005, walk=0.003, walk_rotation=0.0003)


def drive(names, **more):
    return simulate_rig(RigScenario({name: Sensor(noise=SLAM) for name in names}, 30.0, **more), 1)


@pytest.fixture(scope='module')
def rigs():
    """Rigs with all kinds of contents: another vehicle, unobservable z, two sensors, results."""
    level = Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat)
    strange = drive('abcd', motion=level, faults={'c': Fault(elsewhere=True)})
    two = drive('ab').trajectories
    prior = RigConfig(sensors={'b': SensorSettings(
        prior_translation='5,0,0', prior_translation_std='0.01')})
    three = drive('abc').trajectories
    return [calibrate_rig(strange.trajectories), calibrate_rig(two),
            calibrate_rig(three, prior), fuse_results([calibrate(two['a'], two['b'])])]


def test_every_rig_fits_the_schema(rigs, tmp_path):
    result = validator('rig_result.schema.json')
    kinds = set()
    for rig in rigs:
        result.validate(json.loads(json.dumps(rig.to_dict(), allow_nan=False)))
        rig.save(tmp_path / 'rig.yaml')
        result.validate(read_yaml(tmp_path / 'rig.yaml', 'a rig', ConfigError))
        kinds |= {item.kind for item in rig.contradictions}
    assert kinds == {'vehicle', 'prior'}


@pytest.mark.parametrize('change', [
    {'p_value': 2.0}, {'rig_format_version': 2}, {'sensors': {}}, {'more': 1},
    {'pairs': [{'parent': 'a'}]}])
def test_what_is_no_rig_does_not_fit(rigs, change):
    assert not validator('rig_result.schema.json').is_valid({**rigs[0].to_dict(), **change})


def test_every_key_of_rig_yaml_is_described():
    schema = validator('rig.schema.json').schema
    assert set(schema['properties']) == set(_KEYS)
    assert set(schema['$defs']['sensor']['properties']) == {
        *_SOURCES, *_READING, *_KNOWN_OF_SENSOR}


RIG = {'base': 'a', 'bag': 'x.mcap', 'pairs': 'all', 'settings': {'max_time_offset': 1.0},
       'sensors': {'a': {'topic': '/a'}, 'b': {'file': 'b.tum', 'scale': 'free',
                                               'prior_translation': '-,-,1',
                                               'prior_translation_std': 0.1}}}


def test_what_is_read_fits_and_the_rest_is_refused_by_both():
    of_rig = validator('rig.schema.json')
    of_rig.validate(RIG)
    RigDescription.from_dict(RIG)
    for wrong in ({'bases': 'a'}, {'pairs': 'some'}, {'processes': -1}, {'sensors': {}},
                  {'sensors': {**RIG['sensors'], 'b': {'scale': 'free'}}},
                  {'sensors': {**RIG['sensors'], 'b': {'file': 'b', 'topic': '/b'}}},
                  {'sensors': {**RIG['sensors'], 'b': {'file': 'b', 'skale': 'free'}}}):
        assert not of_rig.is_valid({**RIG, **wrong})
        with pytest.raises(ConfigError):
            RigDescription.from_dict({**RIG, **wrong})
