# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The subcommand ``rig``: text, files and page from RIG.yaml."""

from dataclasses import replace
from html.parser import HTMLParser
import json
import re
import shutil
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from benchmarks.simulated_rig import Fault, RigScenario, simulate_rig
from trajectory_calibration import calibrate, ConfigError
from trajectory_calibration.cli.main import main
from trajectory_calibration.config.yaml_file import read_yaml
from trajectory_calibration.errors import ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.frame_tree import FrameTree
from trajectory_calibration.outputs.rig_exports import encode_rig, placements, RIG_FILES
from trajectory_calibration.outputs.rig_report import render_rig
from trajectory_calibration.outputs.rig_screen import format_rig
from trajectory_calibration.rig import RigResult
from trajectory_calibration.rig.advice import with_rig_keys
from trajectory_calibration.rig.description import RigDescription
from trajectory_calibration.rig.windows import common_grid
from trajectory_calibration.simulation.files import write_bag, write_tum
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import flat, Unicycle
from trajectory_calibration.simulation.scenario import Sensor

SLAM = Noise(white=0.003, white_rotation=0.0005, walk=0.003, walk_rotation=0.0003)
RIG = """base: lidar
sensors:
  lidar: {file: lidar.tum, frame: velodyne}
  front: {file: front.tum, frame: camera}
  rear: {file: rear.tum}
settings: {max_time_offset: 1.0}
"""


def drive(**more):
    return simulate_rig(RigScenario(
        {name: Sensor(noise=SLAM) for name in ('lidar', 'front', 'rear')}, 30.0, **more), 1)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """RIG.yaml, its files, and the output of the command."""
    path = tmp_path_factory.mktemp('rig')
    run = drive()
    for name, trajectory in run.trajectories.items():
        write_tum(path / f'{name}.tum', trajectory)
    (path / 'RIG.yaml').write_text(RIG)
    status = main(['rig', str(path / 'RIG.yaml'), '--output', str(path / 'out'),
                   '--report', str(path / 'rig.html')])
    assert status == 0
    return path


@pytest.fixture(scope='module')
def rig(folder):
    return RigResult.load(folder / 'out' / 'rig.yaml')


def test_the_rig_is_saved(rig):
    run = drive()
    assert list(rig.sensors) == ['lidar', 'front', 'rear']
    assert rig.sensors['front'].frame == 'camera'
    step = se3.step_between(run.T_base_sensor['rear'], rig.sensors['rear'].T_base_sensor)
    assert np.linalg.norm(step[:3]) < 0.03


def test_urdf_holds_every_joint(folder, rig):
    tree = FrameTree.read(folder / 'out' / 'rig.urdf')
    assert set(tree.joints) == {'camera', 'rear'}
    np.testing.assert_allclose(
        tree.joints['camera'].T_parent_child, rig.sensors['front'].T_base_sensor, atol=1e-9)
    robot = ET.parse(folder / 'out' / 'rig.urdf').getroot()
    assert [link.get('name') for link in robot.iter('link')] == ['velodyne', 'camera', 'rear']
    # The file is a complete robot, unlike the export of a pair.
    assert 'Paste' not in (folder / 'out' / 'rig.urdf').read_text()
    assert 'Paste' in (folder / 'out' / 'camera' / 'extrinsic.urdf').read_text()


def test_sensor_kit_holds_every_sensor(folder, rig):
    kit = read_yaml(folder / 'out' / 'sensor_kit_calibration.yaml', 'a kit', ConfigError)
    assert set(kit['velodyne']) == {'camera', 'rear'}
    assert kit['velodyne']['rear']['x'] == rig.sensors['rear'].T_base_sensor[0, 3]


def test_launch_file_is_python_with_every_transform(folder):
    text = (folder / 'out' / 'static_transforms.launch.py').read_text()
    compile(text, 'launch', 'exec')
    assert text.count("executable='static_transform_publisher'") == 2
    assert "'--frame-id', 'velodyne'" in text


def test_every_sensor_has_all_exports(folder):
    assert (folder / 'out' / 'camera' / 'extrinsic.urdf').exists()
    assert (folder / 'out' / 'rear' / 'camchain.yaml').exists()


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.text, self.outside = [], [], []

    def handle_starttag(self, tag, attrs):
        self.outside += [value for name, value in attrs
                         if name in ('src', 'href') and value.startswith('http')]
        if tag not in ('meta', 'link', 'input', 'br', 'path', 'circle', 'rect'):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_is_one_whole_file(folder):
    text = (folder / 'rig.html').read_text()
    tags = Tags()
    tags.feed(text)
    assert not tags.open
    assert not tags.outside
    assert len(text) < 300_000
    words = ''.join(tags.text)
    for wanted in ('Rig of 3 sensors in lidar', 'Chi-squared of each pair', 'White noise',
                   'All tracks from above', 'front from lidar'):
        assert wanted in words


def test_the_page_of_two_groups_is_not_called_usable(rig):
    assert rig.unplaced == ()
    assert 'badge">Usable<' in render_rig(rig)
    apart = replace(rig, sensors={
        **rig.sensors, 'rear': replace(rig.sensors['rear'], base='rear')})
    assert apart.unplaced == ('rear',)
    assert 'badge">Incomplete<' in render_rig(apart)


def test_a_page_without_tracks_says_so(rig):
    assert 'The tracks were not given' in render_rig(rig)


def test_the_screen_shows_every_sensor(rig):
    text = format_rig(rig, verbose=True)
    assert 'Rig of 3 sensors in lidar' in text
    assert 'loops close with chi-squared' in text
    for name in ('front', 'rear', 'lidar - front: ', 'drift'):
        assert name in text


def test_json_is_one_object(folder, capsys):
    truth = folder / 'out' / 'rig.yaml'
    assert main(['rig', str(folder / 'RIG.yaml'), '--format', 'json', '--base', 'front']) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['base'] == 'front'
    assert data['sensors']['front']['T_base_sensor']['translation'] == [0, 0, 0]
    assert main(['rig', str(folder / 'RIG.yaml'), '--ground-truth', str(truth)]) == 0
    assert 'error of rear against the ground truth: 0.0000 m' in capsys.readouterr().out


def test_results_are_named_and_not_overwritten(folder, tmp_path, capsys):
    command = ['rig', str(folder / 'RIG.yaml'), '--output', str(tmp_path / 'out')]
    assert main(command) == 0
    assert f'wrote {tmp_path / "out"}\n' in capsys.readouterr().out
    assert main(command) == 2
    assert 'rig.yaml and 4 more exist; give --force' in capsys.readouterr().err
    assert main([*command, '--force', '--format', 'json']) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)['base'] == 'lidar'
    assert f'wrote {tmp_path / "out"}\n' in err


def test_a_rig_with_a_sensor_of_another_drive_is_incomplete(folder, tmp_path, capsys):
    for name in ('lidar', 'front', 'rear'):
        rows = np.loadtxt(folder / f'{name}.tum')
        rows[:, 0] += 1e5 * (name == 'rear')
        np.savetxt(tmp_path / f'{name}.tum', rows, fmt='%.9f')
    (tmp_path / 'RIG.yaml').write_text(RIG)
    assert main(['rig', str(tmp_path / 'RIG.yaml')]) == 3
    assert re.search(r'^  rear +no answer$', capsys.readouterr().out, re.MULTILINE)


def test_a_sensor_that_was_not_compared_is_incomplete(folder, rig, capsys):
    (folder / 'two.yaml').write_text(RIG.replace('  rear: {file: rear.tum}\n', ''))
    replace(rig, recordings=()).save(folder / 'other_drive.yaml')
    assert main(['verify', str(folder / 'other_drive.yaml'), str(folder / 'two.yaml')]) == 3
    assert 'not compared: rear' in capsys.readouterr().out


def test_topics_of_a_bag(tmp_path, capsys):
    write_bag(tmp_path / 'drive', {f'/{k}': v for k, v in drive().trajectories.items()},
              message='odometry', storage='mcap')
    (tmp_path / 'RIG.yaml').write_text(
        'sensors:\n  lidar: {topic: /lidar}\n  front: {topic: /front}\n  rear: {topic: /rear}\n')
    assert main(['rig', str(tmp_path / 'RIG.yaml'), '--bag', str(tmp_path / 'drive')]) == 0
    assert 'Rig of 3 sensors in lidar' in capsys.readouterr().out


def test_saved_results_make_a_rig(tmp_path, capsys):
    run = drive()
    for name in ('front', 'rear'):
        calibrate(run.trajectories['lidar'], run.trajectories[name]).save(
            tmp_path / f'{name}.yaml')
    (tmp_path / 'other.yaml').write_text('no: result\n')
    assert main(['rig', '--from-results', str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert 'Rig of 3 sensors in lidar' in text
    # Two pairs with the base have correlated noise, and no loop.
    assert 'loops' not in text


def test_of_two_results_the_later_recording_counts_whatever_its_name(tmp_path, capsys):
    run = drive()
    lidar, front = (run.trajectories[name] for name in ('lidar', 'front'))
    whole = calibrate(lidar, front)
    half = calibrate(lidar, replace(
        front, stamps_ns=front.stamps_ns[:150], poses=front.poses[:150]))
    half.save(tmp_path / 'node_000010.yaml')
    whole.save(tmp_path / 'node_000009.yaml')
    (tmp_path / 'node_000010').mkdir()
    (tmp_path / 'node_000010' / 'extrinsic.yaml').write_text('parent: lidar\n')
    (tmp_path / 'rig.yaml').write_text('rig_format_version: 1\n')
    (tmp_path / 'notes.yaml').write_text('no: result\n')
    assert main(['rig', '--from-results', str(tmp_path), '--format', 'json']) == 0
    data = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(
        data['sensors']['front']['T_base_sensor']['translation'], whole.T_a_b[:3, 3])
    told = {found['code']: found['text'] for found in data['findings']}
    assert told['rig-result-repeated'] == (
        '2 results of lidar - front: the latest was used, node_000009.yaml')
    assert told['rig-result-unread'].startswith(
        f'not read: {tmp_path}/notes.yaml: not a calibration result:')
    # Of recordings that end together, the file with the highest number.
    replace(half, start_ns=None, scale=2.0).save(tmp_path / 'node_000010.yaml')
    replace(whole, start_ns=None).save(tmp_path / 'node_000009.yaml')
    assert main(['rig', '--from-results', str(tmp_path), '--format', 'json']) == 0
    assert 'used, node_000010.yaml' in capsys.readouterr().out


def test_loops_that_do_not_close_are_not_said_to(rig):
    bad = replace(rig, chi_squared=40.0)
    for text in (format_rig(bad), render_rig(bad)):
        assert 'oops disagree: chi-squared 40.0 of 6 degrees of freedom (p = 4.6e-07)' in text
        assert 'close with' not in text


def test_the_tracks_of_the_page_span_the_gaps_that_the_settings_allow(rig, monkeypatch):
    gaps = []

    def grid(tracks, max_gap_ns):
        gaps.append(max_gap_ns)
        return common_grid(tracks, max_gap_ns)

    monkeypatch.setattr('trajectory_calibration.outputs.rig_report.common_grid', grid)
    render_rig(replace(rig, config=replace(rig.config, calibration=replace(
        rig.config.calibration, max_gap=2.5))), drive().trajectories)
    assert gaps == [2_500_000_000]


def test_a_saved_rig_is_exported_as_a_whole(folder, capsys, tmp_path):
    saved = str(folder / 'out' / 'rig.yaml')
    rig = RigResult.load(saved)
    for name in RIG_FILES:
        assert main(['export', saved, '--as', name]) == 0
        assert capsys.readouterr().out == encode_rig(rig, name, placements(rig)).decode()
    assert main(['export', saved, '--as', 'matrix']) == 2
    assert 'matrix holds one transform' in capsys.readouterr().err
    assert main(['export', saved, '--as', 'urdf', '--parent', 'base_link']) == 2
    assert '--parent is for one transform' in capsys.readouterr().err
    data = rig.to_dict()
    data['sensors']['rear']['status']['z'] = 'unobserved'
    RigResult.from_dict(data).save(tmp_path / 'unobserved.yaml')
    export = ['export', str(tmp_path / 'unobserved.yaml'), '--as', 'urdf']
    assert main(export) == 1
    out, err = capsys.readouterr()
    assert (out, err[:48]) == ('', 'error: not exported: z of rear in velodyne unobs')
    assert main([*export, '--allow-unobserved']) == 3
    assert 'UNOBSERVED: z of rear' in capsys.readouterr().out


def test_a_saved_rig_has_a_page(folder, tmp_path, capsys):
    report = ['report', str(folder / 'out' / 'rig.yaml'), str(folder / 'RIG.yaml'),
              '--output', str(tmp_path / 'x.html')]
    assert main(report) == 0
    assert capsys.readouterr().out == f'wrote {tmp_path}/x.html\n'
    text = (tmp_path / 'x.html').read_text()
    assert 'front from lidar' in text
    assert 'lidar.tum' in text
    assert main(report) == 2
    assert main([*report, '--force', '--plots', str(tmp_path)]) == 2
    assert '--plots is for one pair' in capsys.readouterr().err
    assert 'recording-other' not in text
    # Another trajectory is no evidence for this rig; the page starts with that.
    for name in ('lidar', 'front', 'rear'):
        (tmp_path / f'{name}.tum').write_bytes((folder / f'{name}.tum').read_bytes())
    (tmp_path / 'RIG.yaml').write_text(RIG)
    write_tum(tmp_path / 'front.tum', drive(latency=0.1).trajectories['front'])
    report[2] = str(tmp_path / 'RIG.yaml')
    assert main([*report, '--force']) == 0
    assert f'serious: front of {tmp_path}/RIG.yaml: not the trajec' in capsys.readouterr().err
    assert '<code>recording-other</code>' in (tmp_path / 'x.html').read_text()


def test_unobserved_heights_exit_with_status_three(tmp_path, capsys):
    run = drive(motion=Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat))
    for name, trajectory in run.trajectories.items():
        write_tum(tmp_path / f'{name}.tum', trajectory)
    (tmp_path / 'RIG.yaml').write_text(RIG)
    assert main(['rig', str(tmp_path / 'RIG.yaml'), '--output', str(tmp_path / 'out'),
                 '--report', str(tmp_path / 'rig.html')]) == 3
    text = capsys.readouterr().out
    assert text.count('unknown') == 3
    assert 'z of front, rear unobservable' in text
    assert '(z unknown)' in (tmp_path / 'rig.html').read_text()


def test_an_unobserved_sensor_is_exported_only_on_request(tmp_path, capsys):
    run = drive(motion=Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat))
    for name, trajectory in run.trajectories.items():
        write_tum(tmp_path / f'{name}.tum', trajectory)
    (tmp_path / 'RIG.yaml').write_text(RIG)
    out = tmp_path / 'out'
    command = ['rig', str(tmp_path / 'RIG.yaml'), '--output', str(out)]
    # A withheld export does not remove a file of the user with the same name.
    (out / 'camera').mkdir(parents=True)
    (out / 'camera' / 'extrinsic.urdf').write_text('of a person')
    assert main(command) == 2
    assert 'extrinsic.urdf exists; give --force' in capsys.readouterr().err
    assert (out / 'camera' / 'extrinsic.urdf').read_text() == 'of a person'
    shutil.rmtree(out)
    command.append('--force')
    assert main(command) == 3
    assert capsys.readouterr().err == (
        'not exported: z of camera in velodyne; z of rear in velodyne unobservable. '
        f'To write it anyway: --allow-unobserved, here or in export {out}/rig.yaml --as '
        'FORMAT\n')
    assert [path.name for path in out.iterdir()] == ['rig.yaml']
    # Only the height of the camera is known.
    (tmp_path / 'RIG.yaml').write_text(RIG.replace(
        'frame: camera', "frame: camera, prior_translation: '-,-,0.5', "
        'prior_translation_std: 0.01'))
    assert main(command) == 3
    assert 'not exported: z of rear in velodyne unobservable. ' in capsys.readouterr().err
    assert (out / 'camera' / 'extrinsic.urdf').is_file()
    assert not (out / 'rear').exists()
    assert 'camera' in (out / 'rig.urdf').read_text()
    files = [out / name for name in (
        'rig.urdf', 'static_transforms.launch.py', 'sensor_kit_calibration.yaml',
        'transforms.tum')]
    assert all('rear' not in path.read_text() for path in files)
    assert main([*command, '--allow-unobserved']) == 3
    assert 'not exported' not in capsys.readouterr().err
    assert all('UNOBSERVED: z of rear' in path.read_text() for path in files)
    assert (out / 'rear' / 'extrinsic.urdf').is_file()
    (tmp_path / 'RIG.yaml').write_text(RIG.replace(
        'max_time_offset: 1.0', 'max_time_offset: 1.0, allow_unobserved: true'))
    assert main(command) == 3
    assert 'UNOBSERVED: z of camera' in files[0].read_text()


def test_no_export_of_an_earlier_rig_stays_beside_an_incomplete_one(folder, tmp_path, capsys):
    out = tmp_path / 'out'
    command = ['rig', str(folder / 'RIG.yaml'), '--output', str(out)]
    assert main(command) == 0
    (out / 'rear' / 'notes.txt').write_text('of a person')
    run = drive(motion=Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat))
    for name in ('lidar', 'front'):
        write_tum(tmp_path / f'{name}.tum', run.trajectories[name])
    # One sensor has an unobservable direction, the other one is missing.
    (tmp_path / 'RIG.yaml').write_text(RIG.replace('  rear: {file: rear.tum}\n', ''))
    command[1] = str(tmp_path / 'RIG.yaml')
    assert main(command) == 2
    assert (out / 'rig.urdf').is_file()
    capsys.readouterr()
    assert main([*command, '--force']) == 3
    assert sorted(str(path.relative_to(out)) for path in out.rglob('*')) == [
        'rear', 'rear/notes.txt', 'rig.yaml']
    assert f'removed from {out}, as of an earlier answer: rig.urdf, ' in capsys.readouterr().err


def test_frames_make_no_folder_outside_and_share_none(folder, tmp_path):
    for name in ('lidar', 'front', 'rear'):
        (tmp_path / f'{name}.tum').write_bytes((folder / f'{name}.tum').read_bytes())
    for front, rear, names in (('..', 'rig.urdf', {'_.', 'rig.urdf_2'}),
                               ('a/b', 'a_b', {'a_b', 'a_b_2'})):
        (tmp_path / 'RIG.yaml').write_text(RIG.replace(
            'frame: camera', f"frame: '{front}'").replace(
            'file: rear.tum', f"file: rear.tum, frame: '{rear}'"))
        out = tmp_path / 'below' / 'out'
        assert main(['rig', str(tmp_path / 'RIG.yaml'), '--output', str(out), '--force']) == 0
        assert {path.name for path in out.iterdir() if path.is_dir()} == names
        assert not (out.parent / 'extrinsic.urdf').exists()
        assert {FrameTree.read(out / name / 'extrinsic.urdf').joints.popitem()[0]
                for name in names} == {front, rear}


def test_a_report_that_cannot_be_written_takes_no_rig_away(folder, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise ResultError('disk full')

    def none(*_):
        raise AssertionError('calibrated, although the page cannot be written')

    command = ['rig', str(folder / 'RIG.yaml'), '--report', str(tmp_path / 'x.html')]
    with monkeypatch.context() as patch:
        patch.setattr('trajectory_calibration.cli.rig.write_rig_page', full)
        assert main(command) == 1
        out, err = capsys.readouterr()
        assert 'Rig of 3 sensors in lidar' in out
        assert err == 'error: disk full\n'
    monkeypatch.setattr('trajectory_calibration.cli.rig.calibrate_rig', none)
    command[-1] = str(folder / 'RIG.yaml' / 'x.html')
    assert main(command) == 1
    assert 'RIG.yaml is a file; give another name' in capsys.readouterr().err


def test_advice_for_two_sensors_works_in_the_file(tmp_path, capsys):
    run = drive(motion=Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat))
    for name in ('lidar', 'front'):
        write_tum(tmp_path / f'{name}.tum', run.trajectories[name])
    text = RIG.replace('  rear: {file: rear.tum}\n', '')
    (tmp_path / 'RIG.yaml').write_text(text)
    assert main(['rig', str(tmp_path / 'RIG.yaml')]) == 3
    shown = ' '.join(capsys.readouterr().out.split())
    assert "prior_translation: '-,-,Z' and prior_translation_std: 0.01 below front" in shown
    assert '--prior' not in shown
    assert 'allow_unobserved' not in shown
    (tmp_path / 'RIG.yaml').write_text(text.replace(
        'frame: camera', "frame: camera, prior_translation: '-,-,0.5', "
        'prior_translation_std: 0.01'))
    assert main(['rig', str(tmp_path / 'RIG.yaml')]) == 0


@pytest.mark.parametrize(('text', 'wanted'), [
    ('Use --invert-a --invert-b', (
        'Use invert: true below A in RIG.yaml and invert: true below B in RIG.yaml')),
    ('measure it, or, in the node, set allow_unobserved to publish. Next', 'measure it. Next'),
    ('measure it, or set allow_unobserved', 'measure it'),
    ('or --no-input-checks', 'or input_checks: false in settings of RIG.yaml'),
    ('--quaternion-order-b wxyz?', 'quaternion_order: wxyz below B in RIG.yaml?'),
    ('--max-time-difference=0.1. Or --max-gap=2', (
        'max_time_difference: 0.1 in settings of RIG.yaml. Or max_gap: 2 in settings of RIG.yaml'),
     ),
])
def test_options_become_keys(text, wanted):
    assert with_rig_keys(text, 'A', 'B') == wanted


def test_a_contradicting_sensor_is_named_on_screen_and_page(tmp_path, capsys):
    run = simulate_rig(RigScenario(
        {name: Sensor(noise=SLAM) for name in ('lidar', 'front', 'rear', 'odometry')}, 30.0,
        faults={'rear': Fault(elsewhere=True)}), 1)
    for name, trajectory in run.trajectories.items():
        write_tum(tmp_path / f'{name}.tum', trajectory)
    (tmp_path / 'RIG.yaml').write_text('sensors:\n' + ''.join(
        f'  {name}: {{file: {name}.tum}}\n' for name in run.trajectories))
    assert main(['rig', str(tmp_path / 'RIG.yaml'), '--report', str(tmp_path / 'x.html')]) == 3
    text = capsys.readouterr().out
    assert 'serious: rear does not move as the other sensors do' in text
    assert re.search(r'^  rear +no answer$', text, re.MULTILINE)
    assert 'rear (no answer)' in (tmp_path / 'x.html').read_text()


@pytest.mark.parametrize(('text', 'message'), [
    ('base: a\n', 'sensors is needed'),
    ('1\n', 'holds no rig'),
    ('sensors:\n  a: {file: x}\n  b: {file: y}\nscale: 1\n', "key 'scale' is unknown"),
    ('sensors:\n  a: {fil: x}\n  b: {file: y}\n', "key 'fil' of sensor a is unknown"),
    ('sensors:\n  a: {file: x, topic: /y}\n  b: {file: y}\n', 'sensor a has file and topic'),
    ('sensors:\n  a: {}\n  b: {file: y}\n', 'sensor a has no source'),
    ('sensors:\n  a: x\n  b: {file: y}\n', "sensor a is 'x'"),
    ('sensors:\n  a: {file: x, invert: 1}\n  b: {file: y}\n', 'sensor a: invert is 1'),
    ('sensors:\n  a: {file: x, columns: [1]}\n  b: {file: y}\n', 'sensor a: columns is [1]'),
    ('sensors:\n  a: {file: x}\n  b: {file: y}\nsettings: {solvr: dnl}\n', "'solvr' is unknown"),
    ('sensors:\n  a: {file: x}\n  b: {file: x}\n', 'given twice'),
])
def test_wrong_descriptions_are_wrong_usage(tmp_path, capsys, text, message):
    (tmp_path / 'RIG.yaml').write_text(text)
    assert main(['rig', str(tmp_path / 'RIG.yaml')]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(('arguments', 'message'), [
    ([], 'RIG.yaml is missing'),
    (['--from-results', '.', '--bag', 'x'], '--bag has no meaning'),
])
def test_wrong_usage(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(['rig', *arguments]) == 2
    assert message in capsys.readouterr().err


def test_no_results_are_wrong_usage(tmp_path, capsys):
    assert main(['rig', '--from-results', str(tmp_path)]) == 2
    assert 'holds no .yaml' in capsys.readouterr().err
    (tmp_path / 'x.yaml').write_text('a: 1\n')
    assert main(['rig', '--from-results', str(tmp_path)]) == 2
    assert 'holds no results' in capsys.readouterr().err
    assert main(['rig', '--from-results', str(tmp_path / 'x.yaml')]) == 2
    assert 'x.yaml is no folder; needed one with results' in capsys.readouterr().err


def test_transforms_of_a_bag_and_priors_are_read(tmp_path):
    (tmp_path / 'RIG.yaml').write_text("""bag: drive.mcap
sensors:
  base: {tf: odom.base_link}
  camera: {topic: /camera, scale: free, prior_translation: '-,-,0.5',
           prior_translation_std: 0.01, invert: true}
pairs: all
""")
    found = RigDescription.load(tmp_path / 'RIG.yaml')
    assert found.inputs['base'][0] == 'tf:odom.base_link'
    assert found.inputs['camera'][1].invert
    assert found.bags == (tmp_path / 'drive.mcap',)
    assert found.config.pairs == 'all'
    assert found.config.of('camera').scale == 'free'


def test_frames_that_exports_cannot_hold_are_named_before_the_calibration(
        folder, tmp_path, monkeypatch, capsys):
    def none(*_):
        raise AssertionError('calibrated, although the exports cannot be written')

    monkeypatch.setattr('trajectory_calibration.cli.rig.calibrate_rig', none)
    (folder / 'one_frame.yaml').write_text(RIG.replace('frame: camera', 'frame: velodyne'))
    assert main(['rig', str(folder / 'one_frame.yaml'), '--output', str(tmp_path)]) == 2
    assert 'lidar and front both have the frame velodyne' in capsys.readouterr().err


def test_two_sensors_of_one_frame_are_an_error(rig):
    data = rig.to_dict()
    data['sensors']['rear']['frame'] = 'camera'
    with pytest.raises(ConfigError, match='front and rear both have the frame camera'):
        placements(RigResult.from_dict(data))
