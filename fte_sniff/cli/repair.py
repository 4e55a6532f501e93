"""`fte-sniff repair`: copy everything intact in a damaged recording to a new file."""

from __future__ import annotations

from pathlib import Path

import click

from fte_sniff.cli.input_files import FileName, output_options, print_notes, summary
from fte_sniff.cli.streams import interruptible, print_err
from fte_sniff.errors import UsageError
from fte_sniff.formats.writers import OutputFormat
from fte_sniff.platform import ENDING_SIGNALS
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import Recording
from fte_sniff.session.inputs import InputReading, recording_input
from fte_sniff.session.save import exported, is_same_file


@click.command(name="repair", short_help="Repair a damaged recording.")
@click.argument("file", type=FileName())
@output_options("Write to this file instead of FILE's name with -repaired.")
def command(file: Path, output: Path | None, force: bool) -> None:
    """Repair a damaged recording (.mcap): keep everything intact, and report what was lost.

    FILE is never changed; its intact rows go to a new file. An intact file needs no repair, and no
    new file is written.

    \b
    fte-sniff repair cut.mcap
    fte-sniff repair cut.mcap -o repaired.mcap
    """
    recording = Recording(file)
    target = output or file.with_name(f"{file.stem}-repaired{file.suffix}")
    if is_same_file(target, file):
        raise UsageError(f"{target} is the damaged file itself; name another with -o")
    existing = Existing.REPLACE if force else Existing.REFUSE
    reading = repaired(recording, target, existing)
    if reading is None:
        print_err(f"{file} is whole; there is nothing to repair")
        return
    print_notes(reading)
    print_err(f"kept {summary(reading.tally, reading)}")
    print_err(f"repaired into {target}")


def repaired(recording: Recording, target: Path, existing: Existing) -> InputReading | None:
    """Copy what can be read of a recording to a new file, with a gap where something is lost.

    Returns what was read; None if the recording is intact, and no file is written then. Raises
    FileError if no row can be read of a file with data, or the new file cannot be written.
    """
    if recording.is_intact():
        return None
    reading = InputReading([recording_input(recording)])
    output = exported(target, OutputFormat.MCAP, reading.source(), existing)
    with interruptible(ENDING_SIGNALS), output as write:
        for item in reading:
            write(item)
    return reading
