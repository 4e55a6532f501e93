"""The language of filters is explained; help of live lists its options."""

from __future__ import annotations

import re

import pytest

from fte_sniff.analysis.filter.terms import FILTER_HELP
from fte_sniff.cli import live


@pytest.mark.parametrize("text", ["help", " HELP "])
def test_a_filter_called_help_shows_the_language_and_reads_no_file(run, text: str) -> None:
    done = run("decode", "none.mcap", "--filter", text)
    assert (done.returncode, done.stdout, done.stderr) == (0, FILTER_HELP + "\n", "")


OF_LIVE = (
    "attach share baud dtr rts output force no-record keep-recording rotate max-size min-free pid"
    " plain headless format columns filter alert silence udp serve allow-origin duration count help"
)


def test_help_of_live_lists_26_options_in_groups_of_at_most_eight(run) -> None:
    shown = run("live", "--help").stdout.partition("\nOptions:\n")[2]
    groups = [re.findall(r"^  (?:-\w, )?--([a-z-]+)", part, re.M) for part in shown.split("\n\n")]
    assert sorted(name for group in groups for name in group) == sorted(OF_LIVE.split())
    assert max(map(len, groups)) <= 8
    assert groups[0][:3] == ["attach", "pid", "share"]
    assert not any(option.hidden for option in live.command.params if option.name != "ports")
