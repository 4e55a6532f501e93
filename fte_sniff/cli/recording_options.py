"""Options of a recording and the plan made of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.completion import complete_filter
from fte_sniff.cli.options import (
    DURATION_EXAMPLE,
    Decorator,
    Seconds,
    all_of,
    parse_seconds,
    row_filter,
)
from fte_sniff.errors import UsageError, quoted
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX, OutputFormat
from fte_sniff.recording.output_file import Existing, is_stream
from fte_sniff.recording.retention import (
    DEFAULT_FREE_BYTES,
    DEFAULT_MAX_INDEX_BYTES,
    OnFull,
    RecordingOptions,
    TriggerWindow,
    size_text,
)

if TYPE_CHECKING:
    from fte_sniff.capture.source import Wiring
    from fte_sniff.session.capture_process import CapturePlan


_BYTES = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
_BYTES |= {"ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*((?:[kmgt]i?)?)b?", re.IGNORECASE)
_MEGA_OR_MINUTES = re.compile(r"\d+(?:\.\d+)?\s*m")
_MOST_BYTES = 10**18
_MOST_SECONDS = 10**9
_AUTO = "auto"
_MIN_FILE = 100_000
_MIN_SECONDS = 1.0


def _size(text: str) -> int | None:
    """Bytes; None for `none`."""
    if text.lower() == "none":
        return None
    found = _SIZE.fullmatch(text)
    size = float(found[1]) * _BYTES[found[2].lower()] if found else None
    return round(_bounded(size, _MOST_BYTES, text, "a size; use for example 512MB, 2GB or none"))


def _seconds(text: str) -> float:
    return _bounded(parse_seconds(text), _MOST_SECONDS, text, DURATION_EXAMPLE)


def _bounded(value: float | None, most: int, text: str, example: str) -> float:
    if value is None or value > most:
        fault = "not" if value is None else "too large for"
        raise click.BadParameter(f"{quoted(text)} is {fault} {example}")
    return value


def _rotate(text: str) -> dict[str, int | float | None]:
    """What begins the next file, as fields of `RecordingOptions`; empty for `none`."""
    if text.lower() == "none":
        return {}
    if text.lower() == _AUTO:
        return {"max_index_bytes": DEFAULT_MAX_INDEX_BYTES}
    if _MEGA_OR_MINUTES.fullmatch(text):
        number = text[:-1].strip()
        raise click.BadParameter(f"{quoted(text)} is ambiguous; write {number}MB or {number}min")
    if _SIZE.fullmatch(text):
        return {"rotate_bytes": _size(text)}
    if parse_seconds(text) is not None:
        return {"rotate_s": _seconds(text)}
    raise click.BadParameter(
        f"{text!r} is neither a size nor a time; use for example 512MB or 1h, auto or none"
    )


def _parsed_by(parse: Callable[[str], object]) -> Callable[..., object]:
    return lambda _context, _option, text: None if text is None else parse(text)


def _compact(size: int | None) -> str:
    """A size as a user types it: `20GB`."""
    return "none" if size is None else size_text(size).replace(" ", "")


_WINDOW = TriggerWindow()


def options_with(defaults: RecordingOptions) -> Decorator:
    """A decorator that gives a command the options of a recording, with these defaults."""
    return all_of(
        click.option(
            "--flush-every",
            type=Seconds(min=0.05, max=60),
            default=defaults.flush_every_s,
            show_default=True,
            metavar="S",
            help="Write rows to the disk every S seconds.",
        ),
        click.option(
            "--rotate",
            callback=_parsed_by(_rotate),
            default=_AUTO,
            show_default=True,
            metavar="SIZE|TIME|auto|none",
            help="Begin the next file at 512MB, or after 1h: NAME_00001.mcap, NAME_00002.mcap ...; "
            "auto: after about an hour, so that each is indexed at every moment; none: never.",
        ),
        click.option(
            "--max-size",
            callback=_parsed_by(_size),
            default=_compact(defaults.max_bytes),
            show_default=True,
            metavar="SIZE",
            help="Limit the total size of this capture's files; none: no limit.",
        ),
        click.option(
            "--min-free",
            callback=_parsed_by(_size),
            metavar="SIZE",
            help="Leave this much free on the disk.  "
            f"[default: {_compact(DEFAULT_FREE_BYTES)}, less on a small or full disk]",
        ),
        click.option(
            "--on-full",
            type=click.Choice([word.value for word in OnFull]),
            default=defaults.on_full.value,
            show_default=True,
            help="At a limit: stop recording until there is space, or delete this capture's "
            "oldest file.",
        ),
        click.option(
            "--trigger",
            metavar="EXPR",
            shell_complete=complete_filter,
            help="Keep only the time around rows for which this filter holds: error > 0.",
        ),
        click.option(
            "--before",
            callback=_parsed_by(_seconds),
            metavar="TIME",
            help=f"Keep this much before each trigger.  [default: {_WINDOW.before_s:g}s]",
        ),
        click.option(
            "--after",
            callback=_parsed_by(_seconds),
            metavar="TIME",
            help=f"Keep this much after each trigger.  [default: {_WINDOW.after_s:g}s]",
        ),
    )


recording_options = options_with(RecordingOptions())
"""Gives a command all options of a recording; `options_from` reads them."""


def options_from(
    output: Path | None,
    *,
    flush_every: float,
    rotate: Mapping[str, Any],
    max_size: int | None,
    min_free: int | None,
    on_full: str,
    trigger: str | None,
    before: float | None,
    after: float | None,
) -> RecordingOptions:
    """The recording options of a command line.

    Raises UsageError if the options contradict each other.
    """
    if trigger is None and (before is not None or after is not None):
        raise UsageError("--before and --after need --trigger")
    window = TriggerWindow(
        _WINDOW.before_s if before is None else before, _WINDOW.after_s if after is None else after
    )
    found = RecordingOptions(
        flush_every_s=flush_every,
        **{"max_index_bytes": None, **rotate},
        on_full=OnFull(on_full),
        max_bytes=max_size,
        min_free_bytes=min_free,
        trigger_window=None if trigger is None else window,
    )
    _check(output, found)
    return found


def _check(output: Path | None, found: RecordingOptions) -> None:
    """Raise UsageError for limits that are too small, or several files where only one can be."""
    rotate_bytes, rotate_s, max_bytes = found.rotate_bytes, found.rotate_s, found.max_bytes
    if rotate_bytes is not None and rotate_bytes < _MIN_FILE:
        raise UsageError(f"--rotate: a file has at least {_MIN_FILE // 1000} kB")
    if rotate_s is not None and rotate_s < _MIN_SECONDS:
        raise UsageError(f"--rotate: a file spans at least {_MIN_SECONDS:g} s")
    if max_bytes is not None and max_bytes < _MIN_FILE:
        raise UsageError(f"--max-size: a file has at least {_MIN_FILE // 1000} kB")
    if max_bytes is not None and max_bytes < 2 * (rotate_bytes or 0):
        raise UsageError("--max-size must have room for two files of --rotate; raise it")
    if found.rotates and {rotate_bytes, rotate_s, found.max_index_bytes} == {None}:
        raise UsageError("--on-full rotate-oldest needs several files; leave out --rotate none")
    if found.rotates and output is not None and is_stream(output):
        raise UsageError(f"{output} cannot be rotated: it is not a file; leave out --rotate")


def _check_suffix(output: Path) -> None:
    if FORMAT_BY_SUFFIX.get(output.suffix.lower(), OutputFormat.MCAP) is not OutputFormat.MCAP:
        mcap = output.with_suffix(".mcap")
        raise UsageError(
            f"-o {output}: a capture is recorded as MCAP; name it {mcap},"
            f" and convert it with `fte-sniff decode {mcap} -o {output}`"
        )


def capture_plan(
    wiring: Wiring,
    *,
    output: Path | None,
    force: bool,
    no_record: bool,
    keep_recording: bool,
    duration: float | None,
    count: int | None,
    trigger: str | None,
    zone: tzinfo | None = None,
    **recording: Any,
) -> CapturePlan:
    """The plan of a capture.

    All arguments but the wiring are options, `recording` those of `recording_options`; `zone` is
    that of times in the trigger that name none.

    Raises:
        UsageError: options contradict each other, or `output` has the suffix of another format.
        FilterError: the trigger is not a filter.
    """
    from fte_sniff.session.capture_process import CapturePlan

    needs_file = {"-o": output, "--keep-recording": keep_recording or None, "--trigger": trigger}
    for option, value in needs_file.items():
        if no_record and value is not None:
            raise UsageError(
                f"{option} and --no-record contradict each other; leave one of them out"
            )
    if output is not None and not is_stream(output):
        _check_suffix(output)
    fires = row_filter(trigger, zone)
    existing = Existing.REPLACE if force else Existing.REFUSE
    default = Path(f"fte-sniff-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap")
    return CapturePlan(
        wiring=wiring,
        recording=None if no_record else output or default,
        existing=existing if output else Existing.NUMBER,
        recording_options=options_from(output, trigger=trigger, **recording),
        trigger=None if fires is None else fires.text,
        outlives_view=keep_recording,
        duration_s=duration,
        count=count,
    )
