from __future__ import annotations

import os
from pathlib import Path

import pytest

from fte_sniff.analysis.baud_guess import Condition, Setting, Verdict
from fte_sniff.protocol import Direction
from fte_sniff.session.doctor import (
    folder_finding,
    framer_finding,
    probe_finding,
    terminal_findings,
    verdict_finding,
)
from tests.recording.privilege import unprivileged

AT_57600 = (Setting(57_600, False), 0.99)


@pytest.mark.parametrize("condition", Condition)
@pytest.mark.parametrize("guesses", [((AT_57600),), ((Setting(921_600, True), 0.4),)])
def test_every_verdict_has_words_and_a_way_out(
    condition: Condition, guesses: tuple[tuple[Setting, float], ...]
) -> None:
    verdict = Verdict(condition, 100, 0.5, frozenset({Direction.CONTROL}), guesses)
    finding = verdict_finding("/dev/p", 115_200, verdict)
    assert finding.what
    assert (finding.way_out is None) is (condition is Condition.SOUND)


@pytest.mark.parametrize(
    ("guess", "words", "way_out"),
    [
        (AT_57600, "looks like 57600 baud", "fte-sniff live /dev/p --baud 57600"),
        ((Setting(57_600, False), 0.5), "perhaps 57600", "fte-sniff doctor /dev/p --probe"),
        # What is faster than the receiver only probing can tell for sure.
        (
            (Setting(460_800, False), 0.99),
            "looks like a faster line",
            "fte-sniff doctor /dev/p --probe",
        ),
    ],
)
def test_a_baud_is_named_as_surely_as_it_is_known(
    guess: tuple[Setting, float], words: str, way_out: str
) -> None:
    verdict = Verdict(Condition.WRONG_BAUD, 100, 0.0, guesses=(guess,))
    finding = verdict_finding("/dev/p", 115_200, verdict)
    assert words in finding.what
    assert finding.way_out == way_out


def test_a_probe_that_found_nothing_says_so() -> None:
    assert "no common baud gives frames" in probe_finding("/dev/p", None, None).what


def test_a_folder_with_room_is_well(tmp_path: Path) -> None:
    assert folder_finding(tmp_path).level == "ok"


def test_a_folder_that_is_gone_or_forbidden_is_bad(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert folder_finding(tmp_path / "gone").level == "bad"
    tmp_path.chmod(0o500)
    monkeypatch.chdir(tmp_path)
    with unprivileged():
        finding = folder_finding(Path())
    assert (finding.level, finding.way_out) == ("bad", "cd ~, or name a recording with -o")


@pytest.mark.parametrize(
    ("environment", "encoding", "levels"),
    [
        ({"TERM": "xterm-256color"}, "utf-8", ["ok"]),
        ({"TERM": "xterm"}, "UTF8", ["ok"]),
        ({}, "utf-8", ["warn"]),
        ({"TERM": "dumb"}, "ANSI_X3.4-1968", ["warn", "warn"]),
    ],
)
def test_a_terminal_that_cannot_show_the_screen_is_told(
    environment: dict[str, str], encoding: str, levels: list[str]
) -> None:
    assert [finding.level for finding in terminal_findings(environment, encoding)] == levels


def test_a_framer_that_could_be_faster_is_told_with_what_makes_it_so(tmp_path: Path) -> None:
    assert framer_finding(tmp_path, compiled=True).way_out is None
    told = framer_finding(tmp_path, compiled=False)
    assert told.level == "warn"
    assert "C compiler" in (told.way_out or "")


def test_a_framer_that_was_compiled_before_its_source_was_changed_is_told(tmp_path: Path) -> None:
    source, library = tmp_path / "gap.py", tmp_path / "sources_0__mypyc.so"
    for path, changed in ((source, 1000), (library, 2000)):
        path.touch()
        os.utime(path, (changed, changed))
    assert framer_finding(tmp_path, compiled=True).level == "ok"
    os.utime(source, (3000, 3000))
    told = framer_finding(tmp_path, compiled=True)
    assert told.level == "warn"
    assert "gap.py" in told.what
    assert "pip install" in (told.way_out or "")
