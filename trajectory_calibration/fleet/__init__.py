"""Many recordings of the same sensors: does an extrinsic hold, and when did a sensor move."""

from trajectory_calibration.fleet.comparison import compare, Comparison, Entry
from trajectory_calibration.fleet.verification import Verification, verify

__all__ = ['Comparison', 'Entry', 'Verification', 'compare', 'verify']
