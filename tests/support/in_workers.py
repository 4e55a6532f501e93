"""What tests call in worker processes, in a module that loads little: each process imports it."""

from __future__ import annotations

import os
import signal
import struct
from multiprocessing.connection import Connection
from pathlib import Path

from fte_sniff.protocol.rows import NO_ROWS
from fte_sniff.recording.reader import Recording
from fte_sniff.session.capture_process import CapturePlan, Ended, RowsMessage, Started
from fte_sniff.session.inputs import Input, RecordingInput
from tests.waiting import wait_until


def falls_silent(_plan: CapturePlan, view: Connection) -> None:
    """Stands in for a capture: is stopped for good in the middle of a message."""
    view.send(Started(None))
    os.write(view.fileno(), struct.pack("!i", 1000))
    signal.pause()


def is_behind(_plan: CapturePlan, view: Connection) -> None:
    """Stands in for a capture: has much to send yet when it is requested to end."""
    view.send(Started(None))
    view.recv()
    for total in range(15):
        view.poll(0.2)
        view.send(RowsMessage(NO_ROWS, total, 0))
    view.send(Ended())


def opened_or_killed(path: Path, reader: int, mark: Path) -> Input:
    """The input in the process `reader`, once a worker process has died of it."""
    if os.getpid() != reader:
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    wait_until(mark.exists)
    return RecordingInput(Recording(path))
