"""Measure recordings: count their streams table by table; the public functions that do it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic

from fte_sniff.analysis import events, statistics
from fte_sniff.analysis.segments import Analysis, Counts, Part, Segments, summed
from fte_sniff.analysis.table import EMPTY, Table
from fte_sniff.errors import RecordingWarning, printable
from fte_sniff.recording.reader import Recording
from fte_sniff.session.files import Paths, recordings_in
from fte_sniff.session.inputs import InputReading, ReadingCounts, recording_input
from fte_sniff.session.jobs import mapped

if TYPE_CHECKING:
    from fte_sniff.analysis.check import Verdict
    from fte_sniff.analysis.filter.row_filter import RowFilter


def _counts_of_all(counts: Sequence[Callable[[Table], Counts]], table: Table) -> Counts:
    return {name: one for count in counts for name, one in count(table).items()}


def together(*counts: Callable[[Table], Counts]) -> Analysis[Counts]:
    """The analysis that counts what several functions count."""
    return Analysis(partial(_counts_of_all, counts), summed)


STATISTICS_AND_FINDINGS: Final = together(events.counted, statistics.counted)
"""What `statistics` and `find` need, counted together."""


PARTS: Final = 8
"""Parts that are added at once."""


class Measurement(Generic[Part]):
    """What an analysis counted so far, also after Ctrl-C."""

    def __init__(self, analysis: Analysis[Part]) -> None:
        self.analysis = analysis
        self._parts = [analysis.count(EMPTY)]

    @property
    def total(self) -> Part:
        """What was counted."""
        self._parts = [self.analysis.add(self._parts)]
        return self._parts[0]

    def read(
        self, reading: InputReading, wanted: RowFilter | None = None, baud: int | None = None
    ) -> None:
        """Count all rows of a reading that has no filter.

        Args:
            reading: what to read.
            wanted: selects the rows that are counted; all rows decide which command is answered.
            baud: the baud of every port; None for that of the inputs.
        """
        matches = None if wanted is None else wanted.matches
        for items in reading.streams():
            cutter = Segments(baud=baud, test=matches, keep=self.analysis.keep)
            reading.on_input = cutter.begin
            for item in items:
                for table in cutter.push(item):
                    self.add(self.analysis.count(table))
            for table in cutter.finish():
                self.add(self.analysis.count(table))

    def add(self, part: Part) -> None:
        """Add what was counted elsewhere."""
        self._parts.append(part)
        if len(self._parts) > PARTS:
            self._parts = [self.analysis.add(self._parts)]


# The public functions


def check(
    paths: Paths,
    rules: str | Sequence[str],
    *,
    baseline: Paths | None = None,
    executor: Executor | None = None,
) -> list[Verdict]:
    """The verdicts of rules about recordings, all together, in the order of the rules.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these.
        rules: a text such as `count(malformed) == 0`, see docs/check.md, or several.
        baseline: recordings that rules such as `changed() == 0` compare with.
        executor: reads the files, such as `dask.distributed.Client(...).get_executor()`; by
            default they are read here, one after the other.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none.
        InputTextError: a rule is invalid.

    Warns:
        RecordingWarning: what `fte-sniff check` reports about a file, such as damage.
    """
    from fte_sniff.analysis.check import analysis_of, parse_rule, verdicts

    wanted = [parse_rule(text) for text in ([rules] if isinstance(rules, str) else rules)]
    before = None if baseline is None else _counts_to_compare(baseline)
    return verdicts(_measured(paths, analysis_of(wanted), executor)[0], wanted, before)


def stats(paths: Paths, *, executor: Executor | None = None) -> dict[str, Any]:
    """The numbers of recordings, all together: the object of `stats --format json` (docs/stats.md).

    Takes the paths and the executor of `check`, and raises FileError and warns as it does.
    """
    from fte_sniff.session.stats_json import statistics_json

    return statistics_json(*_measured(paths, statistics.ANALYSIS, executor))


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


def _measured(
    paths: Paths, analysis: Analysis[Part], executor: Executor | None = None
) -> tuple[Part, InputReading]:
    reading = InputReading([recording_input(Recording(path)) for path in recordings_in(paths)])
    measurement = Measurement(analysis)
    groups = [[Path(one.name) for one in group] for group in reading.groups]
    if executor is None:
        measurement.read(reading)
    for total, counts in mapped(partial(_of_group, analysis), groups, executor) if executor else ():
        measurement.add(total)
        reading.include(counts)
    for error in reading.unreadable:
        raise error
    for note in reading.notes:
        warnings.warn(printable(note), RecordingWarning, stacklevel=3)
    return measurement.total, reading


def _of_group(analysis: Analysis[Part], paths: Sequence[Path]) -> tuple[Part, ReadingCounts]:
    measurement = Measurement(analysis)
    reading = InputReading([recording_input(Recording(path.absolute())) for path in paths])
    measurement.read(reading)
    return measurement.total, reading.counts
