"""Options with which the screen is opened."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import tzinfo
from typing import TYPE_CHECKING, Final

from fte_sniff.platform import ENDING_SIGNALS
from fte_sniff.session.notes import Notes
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter


@dataclass(frozen=True, slots=True)
class Choices:
    """What the user chooses on the screen, and has again the next time."""

    theme: str | None = None
    """One of `i18n.THEMES`; None for the default."""
    columns: tuple[str, ...] | None = None
    """From left to right, at least one; None where the width of the window decides."""
    language: str | None = None
    """A key of `i18n.LANGUAGES`, or its `AUTO`; None where it was never chosen."""
    filters: tuple[tuple[str, str], ...] = ()
    """Names of saved filters, each with its filter."""


@dataclass(frozen=True, slots=True)
class StartOptions:
    """How the screen begins, and what holds while it is open."""

    leave_at_end: bool = False
    row_filter: RowFilter | None = None
    alert: Alert | None = None
    notes: Notes | None = None
    """Notes on the rows; None to keep none."""
    signals: tuple[signal.Signals, ...] = ENDING_SIGNALS
    """Signals that close the screen and restore the terminal; others are left alone."""
    pulses_per_turn: float | None = None
    """Encoder pulses per turn of an output shaft, more than 0; None if unknown."""
    language: str = "en"
    """A key of `i18n.LANGUAGES`."""
    choices: Choices = Choices()
    save_choices: Callable[[Choices], None] | None = None
    warnings: tuple[str, ...] = ()
    """Problems from before the screen opened, a sentence each."""
    export_source: ExportSource = field(default_factory=ExportSource)
    """Facts about the rows that are saved with them."""
    zone: tzinfo | None = None
    """Zone of local times, in which the times are shown first; None for that of the machine, and
    UTC first."""


DEFAULTS: Final = StartOptions()
