"""Measure recordings: count their streams table by table; the public functions that do it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.analysis import events, statistics
from fte_sniff.analysis.segments import Analysis, Counts, Segments, summed
from fte_sniff.analysis.table import EMPTY, Table
from fte_sniff.errors import RecordingWarning, printable
from fte_sniff.recording.reader import Recording
from fte_sniff.session.files import Paths, recordings_in
from fte_sniff.session.inputs import InputReading, recording_input

if TYPE_CHECKING:
    from fte_sniff.analysis.check import Verdict
    from fte_sniff.analysis.filter.row_filter import RowFilter


def _counts_of_all(counts: Sequence[Callable[[Table], Counts]], table: Table) -> Counts:
    return {name: one for count in counts for name, one in count(table).items()}


def together(*counts: Callable[[Table], Counts]) -> Analysis:
    """The analysis that counts what several functions count."""
    return Analysis(partial(_counts_of_all, counts))


PARTS: Final = 8
"""Parts that are added at once."""


def measured(
    reading: InputReading,
    analysis: Analysis,
    wanted: RowFilter | None = None,
    baud: int | None = None,
) -> Counts:
    """Count all rows of a reading that has no filter.

    Args:
        reading: what to read.
        analysis: what to count.
        wanted: selects the rows that are counted; all rows decide which command is answered.
        baud: the baud of every port; None for that of the inputs.
    """

    def tables() -> Iterator[Table]:
        for items in reading.streams():
            test = None if wanted is None else wanted.matches
            cutter = Segments(baud=baud, test=test, keep=analysis.keep)
            reading.on_input = cutter.begin
            for item in items:
                yield from cutter.push(item)
            yield cutter.rest()

    return total_of(analysis, map(analysis.count, tables()))


def total_of(analysis: Analysis, parts: Iterable[Counts]) -> Counts:
    """The sum of parts, of which only a few are in memory at once."""
    waiting = [analysis.count(EMPTY)]
    for part in parts:
        waiting.append(part)
        if len(waiting) > PARTS:
            waiting = [summed(waiting)]
    return summed(waiting)


# The public functions


def check(
    paths: Paths,
    rules: str | Sequence[str],
    *,
    baseline: Paths | None = None,
) -> list[Verdict]:
    """The verdicts of rules about recordings, all together, in the order of the rules.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these.
        rules: a text such as `count(malformed) == 0`, see docs/check.md, or several.
        baseline: recordings that rules such as `changed() == 0` compare with.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none.
        InputTextError: a rule is invalid.

    Warns:
        RecordingWarning: what `fte-sniff check` reports about a file, such as damage.
    """
    from fte_sniff.analysis.check import analysis_of, parse_rule, verdict

    wanted = [parse_rule(text) for text in ([rules] if isinstance(rules, str) else rules)]
    before = None if baseline is None else _counts_to_compare(baseline)
    total = _measured(paths, analysis_of(wanted))[0]
    return [verdict(rule, total, before) for rule in wanted]


def stats(paths: Paths) -> dict[str, Any]:
    """The numbers of recordings, all together: the object of `stats --format json` (docs/stats.md).

    Takes the paths of `check`, and raises FileError and warns as it does.
    """
    from fte_sniff.session.stats_json import statistics_json

    return statistics_json(*_measured(paths, statistics.ANALYSIS))


def findings(paths: Paths) -> dict[str, Any]:
    """What is wrong in recordings: the object of `findings --format json` (docs/findings.md).

    Takes the paths of `check`, and raises FileError and warns as it does.
    """
    from fte_sniff.analysis.findings import find
    from fte_sniff.session.stats_json import findings_json

    return findings_json(find(_measured(paths, events.ANALYSIS)[0]))


def compare(before: Paths, after: Paths) -> dict[str, Any]:
    """What changed between recordings: the object of `compare --format json` (docs/compare.md).

    Takes the paths of `check` twice, and raises FileError and warns as it does.
    """
    from fte_sniff.analysis.compare import compared
    from fte_sniff.session.stats_json import comparison_json

    counts = [_counts_to_compare(paths) for paths in (before, after)]
    return comparison_json(compared(*counts), *counts)


def _counts_to_compare(paths: Paths) -> Any:
    from fte_sniff.analysis.compare import ANALYSIS

    return _measured(paths, ANALYSIS)[0]


def _measured(paths: Paths, analysis: Analysis) -> tuple[Counts, InputReading]:
    reading = InputReading([recording_input(Recording(path)) for path in recordings_in(paths)])
    total = measured(reading, analysis)
    for error in reading.unreadable:
        raise error
    for note in reading.notes:
        warnings.warn(printable(note), RecordingWarning, stacklevel=3)
    return total, reading
