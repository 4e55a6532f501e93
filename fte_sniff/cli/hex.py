"""Owns `fte-sniff hex`: bytes that somebody pasted, taken apart at once.

It must load nothing heavy: people run it for one frame and wait for it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from shutil import get_terminal_size

import click

from fte_sniff.cli.outputs import format_option
from fte_sniff.errors import InputTextError, UsageError
from fte_sniff.formats.hex_text import bytes_of_text
from fte_sniff.formats.writers import OutputFormat, RowWriter, row_writer
from fte_sniff.protocol import Chunk, Framer

PORT_NAME = "hex"
"""The port of rows that came from the command line."""


@click.command(name="hex", short_help="Take pasted bytes apart, field by field.")
@click.argument("text", nargs=-1, metavar="BYTES...")
@format_option(None)
def command(text: tuple[str, ...], form: OutputFormat | None) -> None:
    """Decode bytes given as hex, field by field; '-' reads them from standard input.

    Spaces or none, commas, 0x, \\x, colons, upper or lower case, several frames, bytes between
    them, lines from a serial assistant: as people paste it.

    \b
    fte-sniff hex AA 02 02 03 E8 00 00 27 10 EE
    fte-sniff hex "0x55,0x01,0x01,0x03,0xE8,0x00,0x00,0x00,0x0F,0xEE" --format jsonl
    """
    writer = _dissection() if form is None else row_writer(form, sys.stdout, ports=False)
    framer = Framer(PORT_NAME)
    for data in _bytes_of(text):
        writer.write(framer.feed(Chunk(PORT_NAME, None, data)))
    writer.write(framer.flush())
    writer.end()


def _dissection() -> RowWriter:
    from os import environ

    from fte_sniff.formats.dissection import DissectionWriter

    colored = sys.stdout.isatty() and not environ.get("NO_COLOR")
    width = get_terminal_size().columns if sys.stdout.isatty() else None
    return DissectionWriter(sys.stdout, width, colored=colored)


def _bytes_of(words: tuple[str, ...]) -> Iterator[bytes]:
    """The bytes that are asked about, at least one."""
    if "-" in words and len(words) > 1:
        raise UsageError("'-' reads standard input; give either that or bytes, not both")
    if words == ("-",) or (not words and not sys.stdin.isatty()):
        found, source = _bytes_of_stdin(), "standard input"
    else:
        found, source = iter([_bytes_of_words(words)]), "the command line"
    first = next(found, b"")
    if not first:
        raise UsageError(f"no bytes on {source}; try: fte-sniff hex AA 01 01 03 E8 00 00 00 00 EE")
    yield first
    yield from found


def _bytes_of_stdin() -> Iterator[bytes]:
    from fte_sniff.formats.raw import hex_stream_chunks

    for chunk in hex_stream_chunks(sys.stdin.buffer, "standard input"):
        yield chunk.data


def _bytes_of_words(words: tuple[str, ...]) -> bytes:
    try:
        return bytes_of_text(" ".join(words))
    except InputTextError as error:
        from os.path import isfile

        # Not Path.is_file: that raises where a long paste is no possible name.
        if len(words) == 1 and isfile(words[0]):  # noqa: PTH113
            raise UsageError(f"{words[0]} is a file; try: fte-sniff decode {words[0]}") from error
        raise
