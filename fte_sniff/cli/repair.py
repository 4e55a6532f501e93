"""`fte-sniff repair`: copy everything intact in a damaged recording to a new file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import FileName, output_options
from fte_sniff.cli.streams import print_err, progress_line
from fte_sniff.errors import FileError, UsageError

if TYPE_CHECKING:
    from fte_sniff.recording.repair import FileDamage

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
    with progress_line() as line:
        line.progress.step = f"repairing {file}"
        repair = Repair(file)
        if not repair.is_whole:
            repair.write(target, Existing.REPLACE if force else Existing.REFUSE)
    if repair.is_whole:
        print_err(f"{file} is whole; there is nothing to repair")
        return
    damage = repair.damage
    _report_damage(damage)
    kept = f"{damage.kept} rows and port events in {damage.chunks} chunks"
    print_err(f"kept all {kept}" if _nothing_lost(damage) else f"kept {kept}; {_loss_text(damage)}")
    print_err(f"repaired into {target}")


def _nothing_lost(damage: FileDamage) -> bool:
    """True if every row and event is kept, even if bytes around them are damaged."""
    return damage.lost_messages == 0 or (not damage.gaps and not damage.unreadable)


def _report_damage(damage: FileDamage) -> None:
    """Report where the file could not be read, and whether it held rows there."""
    from fte_sniff.recording.repair import lost_text

    whole = _nothing_lost(damage)
    for gap in damage.gaps[:_MOST_GAPS]:
        where = f"damaged: {gap.reason}, which held no rows" if whole else f"lost: {lost_text(gap)}"
        print_err(where)
    if len(damage.gaps) > _MOST_GAPS:
        more = f"{len(damage.gaps) - _MOST_GAPS} more places"
        print_err(f"damaged: {more}, which held no rows" if whole else f"lost: {more}")
    if damage.unreadable:
        print_err(f"lost: {damage.unreadable} messages that could not be read")


def _loss_text(damage: FileDamage) -> str:
    if damage.lost_messages is not None:
        return f"{damage.lost_messages} are lost"
    return "the number of rows after the damage is unknown"
