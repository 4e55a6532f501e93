"""`fte-sniff repair`: copy everything intact in a damaged recording to a new file."""

from __future__ import annotations

from pathlib import Path

import click

from fte_sniff.cli.input_files import FileName, output_options
from fte_sniff.cli.streams import print_err, progress_line
from fte_sniff.errors import FileError, UsageError

_MOST_GAPS = 20


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
    from fte_sniff.recording.output_file import Existing
    from fte_sniff.recording.repair import Repair

    if not file.name:
        raise FileError(f"{file} is a directory; name a recording in it")
    target = output or file.with_name(f"{file.stem}-repaired{file.suffix}")
    if target.exists() and file.exists() and target.samefile(file):
        raise UsageError(f"{target} is the damaged file itself; name another with -o")
    with progress_line() as progress:
        progress.step = f"repairing {file}"
        repair = Repair(file)
        if not repair.is_whole:
            repair.write(target, Existing.REPLACE if force else Existing.REFUSE)
    if repair.is_whole:
        print_err(f"{file} is whole; there is nothing to repair")
        return
    whole = repair.lost_messages == 0 or not (repair.lost or repair.unreadable)
    for lost in repair.lost[:_MOST_GAPS]:
        where = repair.where(lost)
        print_err(f"damaged: {where}, which held no rows" if whole else f"lost: {where}")
    if len(repair.lost) > _MOST_GAPS:
        print_err(f"and {len(repair.lost) - _MOST_GAPS} more places")
    if repair.unreadable:
        print_err(f"lost: {repair.unreadable} messages that could not be read")
    number = repair.lost_messages
    loss = (
        "the number of rows after the damage is unknown" if number is None else f"{number} are lost"
    )
    kept = f"{repair.kept} rows and port events"
    print_err(f"kept all {kept}" if whole else f"kept {kept}; {loss}")
    print_err(f"repaired into {target}")
