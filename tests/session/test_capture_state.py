"""The state of a capture, folded from its messages."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_ROWS
from fte_sniff.recording.recorder import Change, Outcome
from fte_sniff.session.capture_state import CaptureState, Ended, Message, RowsMessage, Started

ONE, TWO = Path("one.mcap"), Path("two.mcap")
FULL = FileError("one.mcap: recording stopped: the disk is full")
NEW = CaptureState(("a", "b"))
BEGUN = Started(ONE)


def batch(
    *changes: Change, rows: int = 0, leftover: int = 0, **events: PortEventKind
) -> RowsMessage:
    happened = [PortEvent(0, port, kind, "") for port, kind in events.items()]
    return RowsMessage(NO_ROWS.with_columns(events=happened), rows, 3, changes, leftover)


def _reporting(*events: PortEvent) -> RowsMessage:
    return replace(batch(), rows=NO_ROWS.with_columns(events=events))


def after(*messages: Message, of: CaptureState = NEW) -> CaptureState:
    return reduce(CaptureState.after, messages, of)


@pytest.mark.parametrize(
    ("messages", "shown"),
    [
        ((), {}),
        ((Started(None),), {}),
        ((BEGUN,), {"recording": "one.mcap", "files": ("one.mcap",)}),
        ((BEGUN, batch(rows=7)), {"rows": 7, "not_shown": 3}),
        ((batch(a=PortEventKind.LOST),), {"waiting": True}),
        ((batch(a=PortEventKind.LOST), batch(b=PortEventKind.FOUND_AGAIN)), {"waiting": True}),
        ((batch(a=PortEventKind.LOST), batch(a=PortEventKind.FOUND_AGAIN)), {"waiting": False}),
        ((batch(a=PortEventKind.LOST), Ended()), {"waiting": False, "ended": "stopped"}),
        ((batch(leftover=1 << 20),), {"trouble": "writing received data: 1,048,576 bytes left"}),
        ((BEGUN, batch(Change(None, FULL))), {"recording": None, "trouble": str(FULL)}),
        (
            (BEGUN, batch(Change(None, FULL)), batch(Change(TWO))),
            {
                "recording": "two.mcap",
                "files": ("one.mcap", "two.mcap"),
                "trouble": f"{FULL}; recording goes on in two.mcap",
            },
        ),
        ((BEGUN, batch(Change(None, FULL)), Ended("gone")), {"trouble": None, "ended": "gone"}),
        ((Started(None, "/dev/pts/7"),), {"title": "a + /dev/pts/7"}),
    ],
)
def test_what_a_view_is_shown(messages: tuple[Message, ...], shown: dict[str, object]) -> None:
    state = after(*messages).feed_state
    usual = FeedState("a + b", running=not any(isinstance(one, Ended) for one in messages))
    expected = {**{name: getattr(usual, name) for name in ("title", "running", "waiting")}, **shown}
    assert {name: getattr(state, name) for name in expected} == expected


def test_why_a_recording_stopped_is_kept_while_it_goes_on_elsewhere() -> None:
    reported = after(BEGUN, batch(Change(None, FULL), Change(TWO)), batch())
    assert (reported.error, reported.stopped_recording) == (FULL, FULL)
    assert (reported.recording, reported.recordings) == (TWO, (ONE, TWO))


def test_the_end_has_the_last_word_on_what_went_wrong() -> None:
    lost, outcome = PortError("a: lost"), Outcome(ONE, TWO)
    reported = after(BEGUN, batch(Change(None, FULL)), Ended("lost", lost, outcome))
    assert (reported.error, reported.stopped_recording, reported.outcome) == (lost, FULL, outcome)
    assert after(BEGUN, batch(Change(None, FULL)), Ended()).error is None
    assert after(BEGUN).outcome is None


@given(
    st.lists(
        st.tuples(
            st.sampled_from("ab"), st.sampled_from([PortEventKind.LOST, PortEventKind.FOUND_AGAIN])
        )
    )
)
def test_a_port_is_away_from_its_loss_until_it_is_found(happened: list) -> None:
    events = [PortEvent(0, port, kind, "") for port, kind in happened]
    last = dict(happened)
    away = {port for port, kind in last.items() if kind is PortEventKind.LOST}
    assert after(_reporting(*events)).lost == away
    assert after(*map(_reporting, events)).lost == away
