"""Owns how the options of a capture become its plan, and which of them contradict each other.

It must not know how a capture runs, nor what shows it.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fte_sniff.cli.capturing.recording_options import check_recording, keeping_of
from fte_sniff.cli.options.filtering import row_filter
from fte_sniff.errors import UsageError

if TYPE_CHECKING:
    from fte_sniff.capture.source import Wiring
    from fte_sniff.session.capture_state import CapturePlan


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
