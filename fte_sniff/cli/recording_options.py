"""Options of a recording and the plan made of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.options import Seconds, row_filter, seconds_of
from fte_sniff.errors import UsageError
from fte_sniff.formats.writers import FORM_BY_END, OutputFormat

if TYPE_CHECKING:
    from fte_sniff.capture.source import Wiring
    from fte_sniff.recording.retention import OnFull, RecordingOptions
    from fte_sniff.session.capture_state import CapturePlan


_BYTES = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
_BYTES |= {"ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*((?:[kmgt]i?)?)b?", re.IGNORECASE)
_LEAST_FILE = 100_000
_LEAST_SECONDS = 1.0


class Rotate(Enum):
    """What `--rotate` can say but a size or a time."""

    AUTO = "auto"
    """Begin the next file before the index of one gets too long to be there at every moment."""
    NONE = "none"
    """One file, however long."""


_ROTATE_WORDS = {word.value: word for word in Rotate}

Told = int | float | Rotate | None
"""Bytes as an int, seconds as a float, what `--rotate` says in a word, or nothing."""


def _size(text: str) -> int | None:
    """Bytes; None for `none`."""
    if text.lower() == "none":
        return None
    found = _SIZE.fullmatch(text)
    if found is None:
        raise click.BadParameter(f"{text!r} is no size; say for example 512MB, 2GB or none")
    return round(float(found[1]) * _BYTES[found[2].lower()])


def _time(text: str) -> float:
    """Seconds."""
    seconds = seconds_of(text)
    if seconds is None:
        raise click.BadParameter(f"{text!r} is no time; say for example 10s, 5min or 1h")
    return seconds


def _rotate(text: str) -> int | float | Rotate | None:
    if text.lower() in _ROTATE_WORDS:
        return _ROTATE_WORDS[text.lower()]
    if (seconds := seconds_of(text)) is not None:
        return seconds
    if _SIZE.fullmatch(text):
        return _size(text)
    raise click.BadParameter(
        f"{text!r} is no size and no time; say for example 512MB or 1h, auto or none"
    )


def _read_by(parse: Callable[[str], Told]) -> Callable[..., Told]:
    """A callback that reads what was given."""
    return lambda _context, _option, text: None if text is None else parse(text)


_OPTIONS = (
    click.option(
        "--flush-every",
        type=Seconds(min=0.05, max=60),
        default=1.0,
        show_default=True,
        metavar="S",
        help="Seconds that rows wait for the disk.",
    ),
    click.option(
        "--rotate",
        callback=_read_by(_rotate),
        default=Rotate.AUTO.value,
        show_default=True,
        metavar="SIZE|TIME|auto|none",
        help="Begin the next file at 512MB, or after 1h: NAME_00001.mcap, NAME_00002.mcap ...; "
        "auto: after about an hour, so that each is indexed at every moment; none: never.",
    ),
    click.option(
        "--max-size",
        callback=_read_by(_size),
        default="20GB",
        show_default=True,
        metavar="SIZE",
        help="What all files of this capture may take; or none.",
    ),
    click.option(
        "--min-free",
        callback=_read_by(_size),
        metavar="SIZE",
        help="What to leave free on the disk.  [default: 1GB, less on a small or full disk]",
    ),
    click.option(
        "--on-full",
        type=click.Choice(["stop", "rotate-oldest"]),
        default="stop",
        show_default=True,
        help="Stop until there is room, or delete this capture's oldest file.",
    ),
    click.option(
        "--trigger",
        metavar="EXPR",
        help="Keep only what surrounds rows for which this holds: error > 0.",
    ),
    click.option(
        "--before",
        callback=_read_by(_time),
        metavar="TIME",
        help="... so long before.  [default: 10s]",
    ),
    click.option(
        "--after",
        callback=_read_by(_time),
        metavar="TIME",
        help="... so long behind.  [default: 5s]",
    ),
)


def recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """All options of a recording under way; the command hands them to `keeping_of`."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def check_recording(output: Path | None) -> None:
    """Refuse a name whose end says that it holds something else than a recording.

    Raises:
        UsageError: it does.
    """
    from fte_sniff.recording.output_file import is_outlet

    if output is None or is_outlet(output):
        return
    if FORM_BY_END.get(output.suffix.lower(), OutputFormat.MCAP) is not OutputFormat.MCAP:
        mcap = output.with_suffix(".mcap")
        raise UsageError(
            f"-o {output}: a capture is recorded as MCAP; name it {mcap},"
            f" and make {output.name} of it with `fte-sniff decode {mcap} -o {output}`"
        )


def keeping_of(
    output: Path | None,
    *,
    flush_every: float,
    rotate: int | float | Rotate | None,
    max_size: int | None,
    min_free: int | None,
    on_full: str,
    trigger: str | None,
    before: float | None,
    after: float | None,
) -> RecordingOptions:
    """What the options ask for.

    Raises:
        UsageError: they contradict each other.
    """
    from fte_sniff.recording.retention import (
        DEFAULT_MOST_INDEX,
        OnFull,
        RecordingOptions,
        TriggerWindow,
    )

    if trigger is None and (before is not None or after is not None):
        raise UsageError("--before and --after surround a trigger; say which with --trigger")
    _check_sizes(rotate, max_size)
    _check_sequence(output, rotate, OnFull(on_full))
    around = TriggerWindow(10.0 if before is None else before, 5.0 if after is None else after)
    return RecordingOptions(
        flush_every_s=flush_every,
        rotate_bytes=rotate if isinstance(rotate, int) else None,
        most_index=DEFAULT_MOST_INDEX if rotate is Rotate.AUTO else None,
        rotate_s=rotate if isinstance(rotate, float) else None,
        on_full=OnFull(on_full),
        most_bytes=max_size,
        free_bytes=min_free,
        around=None if trigger is None else around,
    )


def _check_sizes(rotate: int | float | Rotate | None, max_size: int | None) -> None:
    if isinstance(rotate, int) and rotate < _LEAST_FILE:
        raise UsageError(f"--rotate: a file has at least {_LEAST_FILE // 1000} kB; say more")
    if isinstance(rotate, float) and rotate < _LEAST_SECONDS:
        raise UsageError(f"--rotate: a file spans at least {_LEAST_SECONDS:g} s; say more")
    if max_size is not None and max_size < _LEAST_FILE:
        raise UsageError(f"--max-size: a file has at least {_LEAST_FILE // 1000} kB; say more")
    if isinstance(rotate, int) and max_size is not None and max_size < 2 * rotate:
        raise UsageError("--max-size must have room for two files of --rotate; raise it")


def _check_sequence(output: Path | None, rotate: int | float | Rotate | None, full: OnFull) -> None:
    """Refuse more than one file where there can be only one."""
    from fte_sniff.recording.output_file import is_outlet
    from fte_sniff.recording.retention import OnFull

    rotates_oldest = full is OnFull.ROTATE_OLDEST
    if rotate is Rotate.NONE and rotates_oldest:
        raise UsageError(
            "--on-full rotate-oldest deletes files of several; leave --rotate none out"
        )
    sequence = isinstance(rotate, int | float) or rotates_oldest
    if sequence and output is not None and is_outlet(output):
        raise UsageError(f"{output} cannot be rotated: it is no file; leave --rotate out")


def plan_of(
    wiring: Wiring,
    *,
    output: Path | None,
    force: bool,
    no_record: bool,
    keep_recording: bool,
    duration: float | None,
    count: int | None,
    trigger: str | None,
    **recording: Any,
) -> CapturePlan:
    """The plan of a capture.

    Args:
        wiring: what is captured; all else are the options, `recording` those of
            `recording_options`.

    Raises:
        UsageError: options contradict each other, or `output` is to hold something else.
        FilterError: the trigger is none.
    """
    from fte_sniff.recording.output_file import Existing
    from fte_sniff.session.capture_state import CapturePlan

    if no_record and output is not None:
        raise UsageError("-o names a recording and --no-record wants none; leave one of them out")
    if no_record and keep_recording:
        raise UsageError(
            "--keep-recording and --no-record: there is nothing to keep; leave one out"
        )
    check_recording(output)
    row_filter(trigger)
    existing = Existing.REPLACE if force else Existing.REFUSE
    return CapturePlan(
        wiring=wiring,
        recording=None if no_record else output or _default_path(),
        existing=existing if output else Existing.NUMBER,
        keeping=keeping_of(output, trigger=trigger, **recording),
        trigger=trigger,
        outlives_view=keep_recording,
        duration_s=duration,
        count=count,
    )


def _default_path() -> Path:
    """`fte-sniff-<UTC time>.mcap` in the working folder."""
    return Path(f"fte-sniff-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap")
