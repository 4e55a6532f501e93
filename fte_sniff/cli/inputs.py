"""Owns the way from a file, or standard input, to batches of rows.

It must not know what a command does with the rows. A recording is read by `recording`, all else by
`formats` and framed here.
"""

from __future__ import annotations

import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BufferedReader, FileIO
from itertools import islice
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import click

from fte_sniff.errors import FileError, FteSniffError, UsageError
from fte_sniff.formats.kinds import InputKind, kind_of_content, kind_of_file
from fte_sniff.formats.raw import hex_chunks, hex_stream_chunks, raw_chunks, raw_stream_chunks
from fte_sniff.protocol import (
    FRAME_LENGTH,
    Chunk,
    Damage,
    Fault,
    Framer,
    PortEvent,
    PortEventKind,
    Row,
)

STDIN = Path("-")
STDIN_NAME = "stdin"
"""The port of rows that came through standard input."""

BATCH = 4096
"""Rows handed on at once, at most, where they come one by one."""

TROUBLES = (
    PortEventKind.OVERRUN,
    PortEventKind.LINE_ERROR,
    PortEventKind.LOST,
    PortEventKind.NOT_PASSED_ON,
)
"""Events of a recording that tell of bytes that are not in it, or not as they were sent."""

Note = Callable[[str], None]
"""Takes one line for people about an input, such as that it ends in the middle."""


def input_arguments(command: Callable[..., Any]) -> Callable[..., Any]:
    """The FILE... argument and the `--input` option, as every command that reads files has them."""
    files = click.argument(
        "files", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path)
    )
    kind = click.option(
        "--input",
        "kind",
        type=click.Choice([kind.value for kind in InputKind]),
        callback=lambda _context, _option, word: InputKind(word) if word else None,
        help="What the files hold, where their names do not tell.",
    )
    return files(kind(command))


def check_inputs(files: Sequence[Path], output: Path | None = None) -> None:
    """Refuse a list of inputs that cannot work out, before anything is opened.

    Raises:
        UsageError: standard input is named twice, or the output is one of the inputs.
    """
    if files.count(STDIN) > 1:
        raise UsageError("'-' is standard input, which can be read once; name it once")
    for path in files:
        if output is not None and _same(path, output):
            raise UsageError(f"{output} is an input, and would be lost; name another file with -o")


def _same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


def batches_of(path: Path, kind: InputKind | None, note: Note) -> Iterator[list[Row]]:
    """The rows of one file, or of standard input where `path` is `-`, batch by batch.

    Args:
        path: the file.
        kind: what it holds; None to go by its name or content.
        note: is told, at most once at the end, that the input ended in the middle.

    Raises:
        FileError: it cannot be read, or is not what it should be.
        InputTextError: text in it is not hex.
        UsageError: nothing tells what it holds.
    """
    if path == STDIN:
        return _stdin_batches(kind, note)
    chosen = kind or kind_of_file(path)
    if chosen is InputKind.MCAP:
        return _recording_batches(path, note)
    chunks = raw_chunks(path) if chosen is InputKind.RAW else hex_chunks(path)
    return _framed_batches(chunks, str(path), note)


def _framed_batches(chunks: Iterable[Chunk], name: str, note: Note) -> Iterator[list[Row]]:
    framer = Framer(name)
    rows: list[Row] = []
    some = False
    try:
        for chunk in chunks:
            some = True
            rows += framer.feed(chunk)
            if len(rows) >= BATCH:
                yield rows
                rows = []
    except FteSniffError:
        # What stood before the fault is not lost with it.
        yield rows + framer.flush()
        raise
    if not some:
        raise FileError(f"{name}: is empty; there is nothing to decode")
    rows += framer.flush()
    if rows:
        yield rows
        _note_cut_frame(rows[-1], name, note)


def _note_cut_frame(last: Row, name: str, note: Note) -> None:
    if isinstance(last, Damage) and Fault.TRUNCATED in last.faults:
        note(f"{name}: ends in the middle of a frame ({len(last.raw)} of {FRAME_LENGTH} bytes)")


def _recording_batches(path: Path, note: Note) -> Iterator[list[Row]]:
    from fte_sniff.recording.reader import RecordingReader

    reader = RecordingReader(path)
    entries = reader.entries()
    troubles: Counter[PortEventKind] = Counter()
    while batch := list(islice(entries, BATCH)):
        troubles.update(entry.kind for entry in batch if isinstance(entry, PortEvent))
        yield [entry for entry in batch if not isinstance(entry, PortEvent)]
    for kind in TROUBLES:
        if troubles[kind]:
            note(f"{path}: the port reported {kind} {troubles[kind]:,} times while it was recorded")
    for loss in (*reader.losses, reader.ending):
        if loss:
            note(f"{path}: {loss}")


def _stdin_batches(kind: InputKind | None, note: Note) -> Iterator[list[Row]]:
    stream = BufferedReader(FileIO(sys.stdin.fileno(), closefd=False))
    chosen = kind or kind_of_content(stream.peek(1))
    if chosen is InputKind.MCAP:
        with NamedTemporaryFile(prefix="fte-sniff-stdin-", suffix=".mcap") as file:
            shutil.copyfileobj(stream, file)
            file.flush()
            yield from _recording_batches(Path(file.name), note)
        return
    chunks_of = raw_stream_chunks if chosen is InputKind.RAW else hex_stream_chunks
    yield from _framed_batches(chunks_of(stream, STDIN_NAME), STDIN_NAME, note)
