"""ReplaySession over files with paging."""

from __future__ import annotations

import queue
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from fte_sniff.analysis.feed import FeedState, FeedUpdate, GapDetector, StreamChange, shifted
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol import Gap, PortEvent, Row
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.row_batch import Codebook, RowBatch
from fte_sniff.session.inputs import Input, InputBatch
from fte_sniff.session.pipeline import ANOTHER, DAMAGED, bauds_of
from fte_sniff.session.save import ExportSource

MOST_BATCHES_AHEAD = 6
"""Batches that are read ahead of the view at most."""

MOST_ROWS_A_POLL = 65_536
"""Rows that one poll hands over at most, more or less, so that a screen can draw between two."""

MOST_PACKED_A_POLL = 200_000
"""The same where the rows come packed, and cost a view next to nothing."""


@dataclass(frozen=True, slots=True)
class Read:
    """What was read of a file at once."""

    rows: Sequence[Row]
    events: Sequence[PortEvent] = ()
    """What happened to ports meanwhile."""
    losses: Sequence[str] = ()
    """What the file turned out to lack, one line each; may hold text from it."""
    changes: Sequence[StreamChange] = ()
    """Gaps and baud changes between the rows, by rising index."""


class ReplaySession:
    """Rows that are there already, as a feed for one view."""

    error: FteSniffError | None = None
    """Why reading stopped before the end, if it did."""

    def __init__(
        self,
        batches: Iterable[Read],
        title: str,
        total: int | None = None,
        files: Sequence[str] = (),
    ) -> None:
        """Start reading: one batch at first, and the others once the view has taken it.

        So nothing keeps a screen that opens from drawing its first rows.

        Args:
            batches: rows packed or not; iterated in a thread of its own.
            title: the name of the file, to be shown.
            total: how many rows there will be, more or less; None where nobody knows.
            files: paths of the files that they come from.
        """
        self._total, self._files = total, files
        self._batches = batches
        self._title = title
        self._rows = 0
        self._stop = threading.Event()
        self._onward = threading.Event()
        self._begun = False
        self._losses: list[str] = []
        self._read: queue.Queue[Read | None] = queue.Queue(MOST_BATCHES_AHEAD)
        self._running = True
        self._thread = threading.Thread(target=self._run, name="reads the file", daemon=True)
        self._thread.start()

    def poll(self) -> FeedUpdate:
        """What was read since the poll before; returns at once."""
        if self._begun:
            self._onward.set()
        taken: list[Read] = []
        while self._running and _has_room(taken):
            try:
                batch = self._read.get_nowait()
            except queue.Empty:
                break
            if batch is None:
                self._running = False
            else:
                taken.append(batch)
        self._losses += [loss for read in taken for loss in read.losses]
        changes: list[StreamChange] = []
        came = 0
        for read in taken:
            changes += shifted(read.changes, came)
            came += len(read.rows)
        self._begun |= bool(taken)
        rows = _joined([read.rows for read in taken])
        self._rows += len(rows)
        events = [event for read in taken for event in read.events]
        return FeedUpdate(self._state(), rows, events, changes)

    def rest(self) -> None:
        """Read no more until the next poll, but for what is being read now; returns at once."""
        if not self._stop.is_set():
            self._onward.clear()

    def stop(self) -> None:
        """End reading; returns at once."""
        self._stop.set()
        self._onward.set()

    def _state(self) -> FeedState:
        ended = None
        if not self._running:
            ended = self.error.message if self.error else None
        progress = None
        if self._running and self._total:
            progress = min(1.0, self._rows / self._total)
        return FeedState(
            title=self._title,
            running=self._running,
            ended=ended,
            trouble=_damaged(self._losses),
            live=False,
            rows=self._rows,
            progress=progress,
            files=self._files,
        )

    def _run(self) -> None:
        try:
            for batch in self._batches:
                if not self._put(batch):
                    return
                self._onward.wait()
        except FteSniffError as error:
            self.error = error
        self._put(None)

    def _put(self, batch: Read | None) -> bool:
        while not self._stop.is_set():
            try:
                self._read.put(batch, timeout=0.1)
            except queue.Full:
                continue
            return True
        return False


def _damaged(losses: Sequence[str]) -> str | None:
    """The first loss, and how many more there are; None where nothing is lost."""
    if not losses:
        return None
    if len(losses) == 1:
        return TranslatableText("the file is damaged: {loss}", loss=losses[0])
    return TranslatableText(
        "the file is damaged: {loss}; {count:,} more are told at the end",
        loss=losses[0],
        count=len(losses) - 1,
    )


def _has_room(taken: list[Read]) -> bool:
    rows = sum(len(read.rows) for read in taken)
    loose = sum(len(read.rows) for read in taken if not isinstance(read.rows, RowBatch))
    return rows < MOST_PACKED_A_POLL and loose < MOST_ROWS_A_POLL


def _joined(taken: list[Sequence[Row]]) -> Sequence[Row]:
    taken = [rows for rows in taken if len(rows)]
    if any(isinstance(rows, RowBatch) for rows in taken):
        # A few loose rows become a batch sooner than many packed ones become objects.
        return RowBatch.concat([RowBatch.from_rows(rows) for rows in taken])
    return [row for rows in taken for row in rows]


MOST_HELD: Final = 4
"""Batches that stay unpacked: a filter works from the cursor up and down, and rows of one block
may stand in two batches."""


class RecordingPages:
    """Gives the rows of recordings again; a `BlockSource`."""

    def __init__(self) -> None:
        """Nothing was read yet."""
        self._again: list[Callable[[], RowBatch]] = []
        self._starts: list[int] = []
        self._rows = 0
        self._held: dict[int, RowBatch] = {}
        self._codebook: Codebook | None = None

    def add(self, again: Callable[[], RowBatch], rows: int) -> None:
        """The next so many rows were read; `again` reads the same ones."""
        if rows:
            self._again.append(again)
            # Last, because it is here that a batch is looked up from another thread.
            self._starts.append(self._rows)
            self._rows += rows

    def load(self, start: int, count: int, codebook: Codebook) -> RowBatch:
        """The rows from index `start` on; see `BlockSource`.

        Raises:
            FileError: they cannot be read any more, or are others by now.
        """
        # A copy, so that a block does not keep whole batches in memory.
        rows, done = RowBatch.allocate(codebook, count), 0
        while done < count:
            number = bisect_right(self._starts, start + done) - 1
            first = start + done - self._starts[number]
            piece = self._batch(number, codebook)[first : first + count - done]
            rows.assign(done, piece)
            done += len(piece)
        return rows

    def _batch(self, number: int, codebook: Codebook) -> RowBatch:
        if codebook is not self._codebook:
            self._codebook, self._held = codebook, {}
        held = self._held.pop(number, None)
        if held is None:
            held = self._again[number]().recoded(codebook)
        self._held[number] = held
        while len(self._held) > MOST_HELD:
            self._held.pop(next(iter(self._held)))
        return held


class Viewing:
    """All rows of the inputs, once."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: TimeRange | None,
        baud: int | None,
        pages: RecordingPages | None,
        note: Callable[[str], None],
    ) -> None:
        """Nothing is read yet, but what the inputs tell before their rows.

        Args:
            inputs: what to read, in this order.
            span: only rows in it; None for all.
            baud: of every line, whatever an input says; None to believe the inputs.
            pages: learn how rows are read again; None where they cannot be.
            note: is told what is wrong with an input.
        """
        self._inputs, self._span, self._pages, self._note = inputs, span, pages, note
        self._baud = baud
        self._reported = [one.gaps(span) for one in inputs]
        self._gaps: list[Gap] = [gap for gaps in self._reported for gap in gaps]
        self._detector = GapDetector()
        ports = [port.name for one in inputs for port in one.ports]
        self.origin = ExportSource(
            ports,
            dict.fromkeys(ports, baud) if baud else bauds_of(inputs),
            self._gaps,
            [selection for one in inputs for selection in one.selections()],
        )
        """What is known of the rows; its gaps grow as they are found."""
        if span is not None:
            self._gaps[:] = self.origin.within(span.first_ns, span.end_ns - 1).gaps

    def __iter__(self) -> Iterator[Read]:
        before = None
        for one, gaps in zip(self._inputs, self._reported, strict=True):
            yield from self._reads(one, gaps, follows=one.follows(before))
            before = one

    def _reads(self, one: Input, gaps: Sequence[Gap], *, follows: bool) -> Iterator[Read]:
        changes = self._detector.begin({} if self._baud else bauds_of([one]), gaps)
        if not follows:
            changes.append(self._detector.interrupt(*ANOTHER))
        for batch in one.batches(self._span, self._note):
            if batch.after_gap:
                changes.append(self._detector.interrupt(*DAMAGED))
            if gap := self._detector.observe(batch.times):
                self._gaps.append(gap)
            self._learn(batch)
            changes += self._detector.changes(batch.rows, batch.events)
            yield Read(batch.rows, batch.events, (), changes)
            changes = []
        if one.losses:
            changes.append(self._detector.interrupt(*DAMAGED))
        if changes:
            yield Read((), (), one.losses, changes)

    def _learn(self, batch: InputBatch) -> None:
        if self._pages is not None and batch.reload is not None:
            self._pages.add(batch.reload, len(batch.rows))
