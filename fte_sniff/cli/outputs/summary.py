"""Owns the one-line summary that a command leaves on standard error.

It must not count anything itself; the tally does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fte_sniff.errors import shown
from fte_sniff.protocol import Status, iso_time, status_of

if TYPE_CHECKING:
    from fte_sniff.analysis.counters import Tally
    from fte_sniff.recording.metadata import Stretch


ENOUGH_ROWS = 5
"""Rows of damage alone from which on something is wrong with more than a frame."""


def summary(
    tally: Tally,
    written: int | None = None,
    *,
    partly: bool = False,
    filter_text: str | None = None,
    spanned: bool = False,
    left_out: Sequence[Stretch] = (),
) -> str:
    """What was read: `512 rows, 3 malformed (0.6 %: truncated 2, noise 1), 10.2 s from ...`.

    Args:
        tally: the count of all rows that were read.
        written: how many of them were written, to be told where that is not all.
        partly: whether reading stopped at a limit, so that the numbers are not of the whole input.
        filter_text: what chose the rows that were written; None where all were.
        spanned: whether only rows of a span of time were read.
        left_out: rows that came and that the input does not hold.
    """
    if partly:
        return f"stopped at the limit: {tally.rows:,} rows read so far, {written or 0:,} written"
    parts = [f"{tally.rows:,} row{'s' if tally.rows != 1 else ''}"]
    if written is not None and written != tally.rows:
        parts[0] += f" read, {written:,} written"
    parts += [
        text for status in (Status.SUSPECT, Status.MALFORMED) if (text := _share(tally, status))
    ]
    if len(parts) == 1 and tally.rows:
        parts.append("nothing malformed")
    advice = _missed(tally, written, filter_text, spanned=spanned) or hint(tally)
    lacking = f"; {rows_in_places(left_out)} left out when recorded" if left_out else ""
    return ", ".join(parts) + _span(tally) + lacking + (advice and f"; {advice}")


def rows_in_places(left_out: Sequence[Stretch]) -> str:
    """`893 rows in 2 places`, and `893 rows and more` where of one it is not known how many."""
    rows, places = sum(one.rows or 0 for one in left_out), len(left_out)
    told = f"{rows:,} row{'s' * (rows != 1)}"
    if any(one.rows is None for one in left_out):
        told = f"{told} and more" if rows else "nobody knows how many rows"
    return f"{told} in {places:,} place{'s' * (places != 1)}"


def _missed(tally: Tally, written: int | None, filter_text: str | None, *, spanned: bool) -> str:
    """What left no row, where rows may have been there; empty elsewhere."""
    if not tally.rows and spanned:
        return "none lies between --from and --to"
    if tally.rows and written == 0 and filter_text is not None:
        return f"none of them passes the filter: {shown(filter_text)}"
    return ""


def hint(tally: Tally) -> str:
    """What to look at where nothing came, or nothing that could be read; empty elsewhere."""
    if not tally.rows:
        return "nothing came: check the wire, the ground and the baud rate"
    if tally.rows >= ENOUGH_ROWS and not tally.frames:
        return "no frame in it: is it this controller, this baud rate, this polarity?"
    return ""


def _share(tally: Tally, status: Status) -> str:
    count = tally.by_status[status]
    if not count:
        return ""
    faults = ", ".join(
        f"{fault} {found:,}"
        for fault, found in tally.by_fault.items()
        if found and status_of((fault,)) is status
    )
    return f"{count:,} {status} ({count / tally.rows:.2%}: {faults})"


def _span(tally: Tally) -> str:
    if tally.first_ns is None or tally.duration_ns is None:
        return ""
    return f", {tally.duration_ns / 1e9:,.3f} s from {iso_time(tally.first_ns)}"
