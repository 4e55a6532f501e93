"""Owns rows as lines for people: plain, or coloured on a terminal, under one header.

It must not know where the rows come from or what is in the cells; the layout says that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, TextIO

from fte_sniff.formats.tables.layout import GAP, Layout
from fte_sniff.protocol import Frame, Row, Status

if TYPE_CHECKING:
    import polars as pl
    from rich.console import Console


class PlainWriter:
    """Writes one plain line a row, with every column at its place, for pipes and files."""

    tells_order = True

    def __init__(self, stream: TextIO, *, ports: bool) -> None:
        self._stream = stream
        self._ports = ports
        self._layout: Layout | None = None

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows; the first one decides whether there is a column for the time."""
        if rows:
            cells = self._laid_out(times=rows[0].t_ns is not None).cells
            self._stream.writelines(_joined(cells(row)) for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a frame that has the contract's columns, and each its certain place."""
        from fte_sniff.formats.tables.frame_lines import frame_lines

        if frame.height:
            layout = self._laid_out(times=frame["time"][0] is not None)
            self._stream.write(frame_lines(frame, layout))

    def _laid_out(self, *, times: bool) -> Layout:
        """What the first row decided, under the header."""
        if self._layout is None:
            self._layout = Layout(times=times, ports=self._ports)
            self._stream.write(_joined(self._layout.header()))
        return self._layout

    def end(self) -> None:
        """Nothing is held back."""


def _joined(cells: Iterable[str]) -> str:
    return GAP.join(cells).rstrip() + "\n"


class RichWriter:
    """Writes one coloured line a row, cut at the terminal's right edge.

    Where the terminal is too narrow for the whole line, the times are short, the offsets are left
    out, and what is wrong with a row stands before its bytes.
    """

    def __init__(self, console: Console, *, ports: bool) -> None:
        self._console = console
        self._ports = ports
        self._cells: Callable[[Row], Iterable[str]] | None = None

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows; the first one decides whether there is a column for the time."""
        if rows and self._cells is None:
            self._cells = self._begin(Layout(times=rows[0].t_ns is not None, ports=self._ports))
        if self._cells is not None:
            for row in rows:
                self._print(GAP.join(self._cells(row)), style_of(row))

    def _begin(self, layout: Layout) -> Callable[[Row], Iterable[str]]:
        """Write the header, and choose the cells that the terminal has room for."""
        if self._console.width >= layout.width:
            self._print(GAP.join(layout.header()), "bold")
            return layout.cells
        self._print(GAP.join(layout.narrow_header()), "bold")
        return layout.narrow_cells

    def end(self) -> None:
        """Nothing is held back."""

    def _print(self, line: str, style: str) -> None:
        self._console.print(
            line.rstrip(),
            style=style,
            markup=False,
            highlight=False,
            emoji=False,
            no_wrap=True,
            overflow="ellipsis",
            crop=True,
        )


def style_of(row: Row) -> str:
    """The rich style of a row: damage and doubt stand out, else the direction and kind tell."""
    if row.status is Status.MALFORMED:
        return "bold red"
    if row.status is Status.SUSPECT:
        return "yellow"
    kind = row.kind if isinstance(row, Frame) else None
    if kind is None or not kind.fields:
        return "bold magenta"
    return "cyan" if kind.direction == "control" else "default"
