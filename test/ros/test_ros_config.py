# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files in config/ name what the node really has."""

from importlib.util import find_spec
import json
from pathlib import Path
import shutil
import subprocess
import xml.etree.ElementTree as ET

import pytest
from ros_if_any import needs_ros, ros
from ruamel.yaml import YAML

pytestmark = [needs_ros, pytest.mark.ros]

CONFIG = Path(__file__).resolve().parents[2] / 'config'
NODE = '/trajectory_calibration'
# Only with publish_tf.
OPTIONAL = {'/tf_static'}


@pytest.fixture(scope='module')
def interface(tmp_path_factory):
    """Return the names of what a node publishes and offers, as without a namespace."""
    with ros.running(tmp_path_factory.mktemp('interface')) as (_, client):
        client.wait(lambda: client.status('calibration') is not None, 'the node')
        owner = 'trajectory_calibration', client.namespace
        # Its messages may arrive before the graph knows whose they are.
        client.wait(lambda: owner in client.node.get_node_names_and_namespaces(),
                    'the node in the graph')
        client.wait(lambda: f'{client.namespace}/trajectory_calibration/calibrate' in {
            name for name, _ in client.node.get_service_names_and_types_by_node(*owner)},
            'its services')
        published = {name for name, _ in client.node.get_publisher_names_and_types_by_node(*owner)}
        served = {name for name, _ in client.node.get_service_names_and_types_by_node(*owner)}
    return ({name.removeprefix(client.namespace) for name in published},
            {name.removeprefix(client.namespace) for name in served})


def full(name):
    return name.replace('~', NODE, 1)


def test_the_documentation_names_the_whole_interface(interface):
    text = (CONFIG.parent / 'docs' / 'node.md').read_text()
    foreign = ('/rosout', '/parameter_events', 'parameter', 'get_type_description')
    names = {name.replace(NODE, '~', 1) for part in interface for name in part
             if not any(word in name for word in foreign)}
    assert {'~/calibrate', '~/extrinsic', '/diagnostics'} <= names
    assert not [name for name in names if f'`{name}`' not in text]


def test_the_rviz_layout_shows_topics_of_the_node(interface):
    layout = YAML(typ='safe').load((CONFIG / 'calibration.rviz').read_text())
    topics = {display['Topic']['Value'] for display in layout['Visualization Manager']['Displays']
              if 'Topic' in display}
    assert topics == {f'{NODE}/path_a', f'{NODE}/path_b', f'{NODE}/markers'}
    assert topics <= interface[0]


def test_the_foxglove_layout_shows_topics_and_calls_a_service_of_the_node(interface):
    panels = json.loads((CONFIG / 'calibration.foxglove.json').read_text())['configById']
    topics = set(panels['3D!tracks']['topics'])
    topics.add(panels['RawMessages!extrinsic']['topicPath'])
    topics.add(panels['DiagnosticSummary!node']['topicToRender'])
    assert topics <= interface[0]
    assert panels['CallService!calibrate']['serviceName'] in interface[1]


def test_the_security_policy_allows_exactly_what_the_node_does(interface):
    profile = ET.parse(CONFIG / 'sros2_policy.xml').find('.//profile')
    allowed = {full(topic.text) for topic in profile.findall("topics[@publish='ALLOW']/topic")}
    assert allowed - OPTIONAL == interface[0]
    assert {full(service.text) for service in profile.findall('services/service')} == interface[1]


@pytest.mark.skipif(shutil.which('systemd-analyze') is None, reason='systemd is missing')
def test_systemd_takes_the_unit():
    done = subprocess.run(
        ['systemd-analyze', 'verify', str(CONFIG / 'calibration.service')],
        capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.skipif(find_spec('sros2') is None, reason='sros2 is missing')
def test_sros2_takes_the_policy():
    from sros2.policy import load_policy
    assert load_policy(CONFIG / 'sros2_policy.xml') is not None


@pytest.mark.skipif(find_spec('ament_xmllint') is None, reason='ament_xmllint is missing')
def test_package_xml_is_valid():
    from ament_xmllint.main import main
    assert main(argv=[str(CONFIG.parent / 'package.xml')]) == 0


@pytest.mark.skipif(find_spec('ament_copyright') is None, reason='ament_copyright is missing')
def test_every_file_names_its_licence():
    from ament_copyright.main import main
    assert main(argv=[str(CONFIG.parent / name) for name in (
        'trajectory_calibration', 'launch', 'setup.py')]) == 0
