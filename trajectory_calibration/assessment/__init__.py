# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How good a solution is: covariance, observability, checks of the input, priors."""
