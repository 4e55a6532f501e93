"""Recordings of every layout that the program has written are read the same.

The files in `tests/recording/layouts` are in the order in which the layouts came. Each has the rows
of two ports, with damage and 44 bytes of noise, and the events `opened` and `closed`:

    1, 2  every message by protobuf, an index at the end
    3     the index twice, so that a cut file has one
    4     each definition once; ports in the metadata
    5     copies of the ports between the chunks; time, order and count of events
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.rows import MOST_BYTES
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from tests.recording.samples import events_in, rows_in

FOLDER = Path(__file__).parent / "layouts"


def expected(layout: int) -> list[tuple[object, ...]]:
    """The rows that were written; noise beyond 16 bytes as several rows."""
    found: list[tuple[object, ...]] = []
    for line in (FOLDER / f"rows-{min(layout, 2)}.jsonl").read_text().splitlines():
        port, offset, text, t_ns, faults = json.loads(line)
        raw = bytes.fromhex(text)
        for at in range(0, len(raw), MOST_BYTES):
            found.append((port, offset + at, raw[at : at + MOST_BYTES], t_ns, faults))
    return found


@pytest.mark.parametrize("layout", range(1, 6))
def test_an_earlier_layout_has_the_same_rows(layout: int) -> None:
    path = FOLDER / f"{layout}.mcap"
    recording = Recording(path)
    rows = rows_in(path)
    found = [
        (row.port, row.offset, row.raw, row.t_ns, sorted(map(str, row.faults))) for row in rows
    ]
    assert found == expected(layout)
    assert all(row.delay_ns is not None for row in rows)
    assert [event.kind for event in events_in(path)] == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert recording.ports == [PortFacts("a", 115_200), PortFacts("b", 57_600)]
    assert recording.facts["host"] == "bench"
    assert recording.is_whole


@pytest.mark.parametrize("layout", range(1, 6))
def test_an_earlier_layout_that_is_cut_has_the_rows_of_its_chunks(
    layout: int, tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    whole = FOLDER / f"{layout}.mcap"
    for chunk in Recording(whole).contents.chunks[1:]:
        path.write_bytes(whole.read_bytes()[: chunk.start + 40])
        recording = Recording(path)
        rows = rows_in(path)
        assert [row.raw for row in rows] == [row[2] for row in expected(layout)][: len(rows)]
        assert len(rows) >= 40
        assert recording.losses
