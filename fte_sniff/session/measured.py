"""Measure recordings: models that observe a stream, and the public check() and stats()."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from fte_sniff.analysis.model import RowModel
from fte_sniff.errors import RecordingWarning, printable
from fte_sniff.protocol import PortEvent
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.recording.reader import Recording
from fte_sniff.session.files import Paths, recordings_in
from fte_sniff.session.inputs import InputReading, recording_input

if TYPE_CHECKING:
    from fte_sniff.analysis.rules import Verdict

Model = TypeVar("Model", bound=RowModel)


def observe(items: Iterable[Item], *models: RowModel) -> None:
    """Let models observe a stream."""
    for item in items:
        for model in models:
            if isinstance(item, Rows):
                model.observe(item)
            elif isinstance(item, PortEvent):
                model.observe_events([item])
            else:
                model.observe_change(item)


def check(paths: Paths, rules: str | Sequence[str]) -> list[Verdict]:
    """The verdicts of rules about recordings, all together, in the order of the rules.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these.
        rules: a text such as `count(malformed) == 0`, see docs/check.md, or several.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none.
        InputTextError: a rule is invalid.

    Warns:
        RecordingWarning: what `fte-sniff check` reports about a file, such as damage.
    """
    from fte_sniff.analysis.rules import RuleCheck, parse_rule

    listed = [rules] if isinstance(rules, str) else rules
    return _measured(paths, RuleCheck([parse_rule(text) for text in listed]))[0].verdicts()


def stats(paths: Paths) -> dict[str, Any]:
    """The numbers of recordings, all together: the object of `stats --format json` (docs/stats.md).

    Takes the paths of `check`, and raises FileError and warns as it does.
    """
    from fte_sniff.analysis.statistics import LineSetup, StatisticsSummary
    from fte_sniff.session.stats_json import statistics_json

    return statistics_json(*_measured(paths, StatisticsSummary(LineSetup())))


def _measured(paths: Paths, model: Model) -> tuple[Model, InputReading]:
    reading = InputReading([recording_input(Recording(path)) for path in recordings_in(paths)])
    for name, items in reading.streams():
        model.begin(name)
        observe(items, model)
    for error in reading.unreadable:
        raise error
    for note in reading.notes:
        warnings.warn(printable(note), RecordingWarning, stacklevel=3)
    return model, reading
