"""The capture process and the lines between it and its view."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.capture.wiring import Wiring
from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import RecordingOptions
from fte_sniff.session.control import CapturePlan, CaptureState, start
from tests.slow import first
from tests.waiting import BOUND_S


def test_state_is_one_line_that_gives_the_state() -> None:
    error = FileError("{path}: {why}", path=Path("x"), why=TranslatableText("is full"))
    state = CaptureState(["é.mcap"], None, "/dev/pts/3", error, unrecorded=12)
    line = state.line()
    assert line.count(b"\n") == 1
    found = CaptureState.parse(line)
    assert isinstance(found.error, FileError)
    assert found.error.message == error.message
    assert found.error.message.form == error.message.form  # type: ignore[attr-defined]
    assert replace(found, error=error) == state


def test_plan_is_one_line_that_gives_the_plan() -> None:
    settings = PortSettings(9600, dtr=True)
    plan = CapturePlan(
        Wiring(["/dev/ttyUSB0"], settings, "bridge", "/tmp/é"),
        Path("x.mcap"),
        Existing.NUMBER,
        RecordingOptions(rotate_s=1.5),
        count=3,
    )
    line = plan.line()
    assert line.count(b"\n") == 1
    assert CapturePlan.parse(line) == plan


@pytest.mark.program
@pytest.mark.parametrize("entry", first(3, ["", ".", "{link}", "{here}", "{here}/", "x/.."]))
def test_the_working_folder_is_on_no_import_path(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch, entry: str
) -> None:
    """Whatever the environment and this process have on theirs."""
    executed = tmp_path_factory.mktemp("marker") / "executed"
    for name in ("encodings", "struct", "json", "numpy", "serial"):
        poison = f"import posix\nposix.open({str(executed)!r}, posix.O_CREAT)\n"
        (tmp_path / f"{name}.py").write_text(poison)
    link = executed.with_name("link")
    link.symlink_to(tmp_path)
    (tmp_path / "x").mkdir()
    monkeypatch.chdir(tmp_path)
    entry = entry.format(here=tmp_path, link=link)
    monkeypatch.setenv("PYTHONPATH", f"{entry}{os.pathsep}/usr/share")
    monkeypatch.setattr(sys, "path", [entry, *sys.path])
    process = start(CapturePlan(Wiring(["/dev/absent"]), tmp_path / "x.mcap"))
    line = process.communicate(timeout=BOUND_S)[0]
    assert process.returncode == 0
    assert "/dev/absent" in str(CaptureState.parse(line).error)
    assert not executed.exists()
