"""Rows and a feed for the tests of the screen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from fte_sniff.analysis.feed import FeedState, FeedUpdate, StreamChange
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Damage,
    Fault,
    Frame,
    PortEvent,
    Row,
    encode,
    frame_faults,
)

NOON_NS = 1_769_860_800_000_000_000
"""2026-01-31T12:00:00Z."""

STEP_NS = 1_000_000


class ListFeed:
    """A feed of what a test gives it."""

    def __init__(self) -> None:
        self.state = FeedState("/dev/ttyUSB0", "/tmp/a.mcap")
        self.stops = 0
        self._rows: list[Row] = []
        self._events: list[PortEvent] = []
        self.changes: list[StreamChange] = []

    def give(self, rows: Sequence[Row]) -> None:
        self._rows += rows
        self.state = replace(self.state, rows=self.state.rows + len(rows))

    def tell(self, event: PortEvent) -> None:
        self._events.append(event)

    def end(self, why: str) -> None:
        self.state = replace(self.state, running=False, ended=why)

    def poll(self) -> FeedUpdate:
        update = FeedUpdate(self.state, self._rows, self._events, self.changes)
        self._rows, self._events, self.changes = [], [], []
        return update

    def stop(self) -> None:
        self.stops += 1


def _speed_rows(count: int, start: int = 0, port: str = "/dev/ttyUSB0") -> list[Row]:
    """Rows that a millisecond parts: speed commands whose RPM is the number of the row."""
    rows: list[Row] = []
    for number in range(start, start + count):
        raw = encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 4, "rpm": number % 30_000})
        rows.append(Frame(port, 10 * number, raw, NOON_NS + number * STEP_NS))
    return rows


def _odd_rows() -> list[Row]:
    """One row of every sort that is not in order."""
    bad_motor = bytes.fromhex("AA0109000100000000EE")
    reserved = bytes.fromhex("AA010100010000070000EE")[:9] + b"\xee"
    unknown = bytes.fromhex("AA7701000100000000EE")
    rows: list[Row] = [
        Frame("p", 0, raw, NOON_NS, frame_faults(raw)) for raw in (bad_motor, reserved, unknown)
    ]
    return [
        *rows,
        Damage("p", 30, bytes.fromhex("AA0101000100000000EF"), NOON_NS, (Fault.BAD_TAIL,)),
        Damage("p", 40, b"\x01\x02\x03", None, (Fault.NOISE,)),
        Damage("p", 43, bytes(range(256)) * 4, NOON_NS, (Fault.NOISE, Fault.LINE_ERROR)),
        Damage("p", 1067, bytes.fromhex("AA01010001EE"), NOON_NS, (Fault.TRUNCATED,)),
        Damage("p", 1073, bytes.fromhex("AA0101000100000000000000EE"), 0, (Fault.OVERLONG,)),
    ]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache folder, where copies are kept."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder


@pytest.fixture
def samples() -> Path:
    return Path(__file__).parents[2] / "samples"


@pytest.fixture
def feed() -> ListFeed:
    return ListFeed()


@pytest.fixture
def speed_rows() -> Callable[..., list[Row]]:
    return _speed_rows


@pytest.fixture
def odd_rows() -> list[Row]:
    return _odd_rows()
