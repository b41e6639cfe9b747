# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The end of the process by a signal, from before the first import that takes time.

Nothing here imports ROS or anything that takes time to load.
"""

from __future__ import annotations

import signal
from types import FrameType


class StopSignals:
    """Turns SIGINT, SIGTERM and SIGHUP, which a terminal that closes sends, into a flag.

    The handlers of rclpy race with the executor: some runs hang, some end in a traceback. A flag
    that the loop reads ends every run the same way.

    Attributes
    ----------
    received : whether one of them has come.

    """

    def __init__(self) -> None:
        self.received = False
        self._numbers = [signal.SIGINT, signal.SIGTERM]
        # nohup has it ignored: the node is to outlive its terminal.
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            self._numbers.append(signal.SIGHUP)
        for number in self._numbers:
            signal.signal(number, self._on_signal)

    def ignore(self) -> None:
        """Ignore the signals from now on: the process ends by itself.

        Python takes its handlers away before it has ended. A second signal then, as an impatient
        person sends, would be the end of the process and its status.
        """
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.received = True
