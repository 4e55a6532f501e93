"""`fte-sniff view`: the screen of `live` on files."""

from __future__ import annotations

import sys
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path

import click

from fte_sniff.analysis.filter.row_filter import Alert
from fte_sniff.cli.input_files import (
    STDIN,
    InputQuery,
    exit_if_unreadable,
    follow_option,
    input_options,
    print_notes,
    print_saved,
)
from fte_sniff.cli.options import alert_option, grouped_command
from fte_sniff.cli.settings import lang_option, load_settings
from fte_sniff.cli.streams import ending_signals
from fte_sniff.errors import UsageError
from fte_sniff.real_number import RealNumber


@grouped_command(name="view", short_help="Show files on the screen of live.")
@input_options(required=False)
@follow_option
@alert_option
@click.option(
    "--play",
    "play_speed",
    type=RealNumber(0.1, 100),
    metavar="SPEED",
    help="Play the rows as fast as they came, or 0.1 to 100 times as fast.",
)
@lang_option
def command(
    query: InputQuery,
    alert: Alert | None,
    play_speed: float | None,
    following: bool,
    lang: str | None,
) -> None:
    """Show recordings, raw bytes or hex text on the screen of `live`.

    A folder means the recordings in it. The rows of several files are merged by time. Without a
    FILE, the latest recording of this folder is shown.

    \b
    fte-sniff view samples/damaged.mcap
    fte-sniff view --follow capture.mcap
    fte-sniff view --play 4 samples/clean.mcap
    """
    if STDIN in query.files or not (sys.stdout.isatty() and sys.stdin.isatty()):
        raise UsageError(
            "view needs files and a terminal; 'fte-sniff decode' reads - and writes to pipes"
        )
    settings = load_settings()
    language = settings.language(lang)
    if not query.files:
        query = replace(query, files=(_latest(),))
    from fte_sniff.protocol.rows import Item, Rows
    from fte_sniff.session.feeds import FileFeed, played
    from fte_sniff.session.notes import Notes
    from fte_sniff.tui.app import run_screen
    from fte_sniff.tui.options import StartOptions

    wanted, paths = query.row_filter(), query.paths()
    follower = query.follower() if following else None
    reading = query.read(follower)
    items, begun = iter(reading), list[Item]()
    # The first rows are read now, so that an error comes before the screen.
    for item in items:
        begun.append(item)
        if isinstance(item, Rows):
            break
    source = reading.source()
    several = len(reading.inputs) > 1
    notes = Notes({Path(one.name): one.first_ns() if several else None for one in reading.inputs})
    shown = chain(begun, items)
    session = FileFeed(
        shown if play_speed is None else played(shown, play_speed),
        " ".join(map(str, query.files)),
        reading.total,
        list(map(str, paths)),
        follower,
        plays=play_speed is not None,
    )
    opening = StartOptions(
        row_filter=wanted,
        alert=alert,
        pulses_per_turn=settings.pulses_per_turn(source.ports),
        export_source=source,
        zone=query.zone_given(),
        language=language,
        choices=settings.choices,
        save_choices=settings.keep,
        warnings=(*settings.trouble, *notes.damage),
        notes=notes,
    )
    with closing(session):
        code = run_screen(session, opening)
    with ending_signals(session.stop) as begin_end:
        begin_end()  # a stopped terminal may not block the exit
        print_notes(reading)
        print_saved(notes)
    if session.error is not None:
        raise session.error
    exit_if_unreadable(reading)
    sys.exit(code)


def _latest() -> Path:
    """The latest recording of this folder."""
    found = max(Path().glob("*.mcap"), key=lambda path: path.stat().st_mtime, default=None)
    if found is None:
        raise UsageError("this folder has no recording; name a FILE")
    return found
