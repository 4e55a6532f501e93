"""Processes that the program starts."""

from __future__ import annotations

import json
import os
import sys
from io import FileIO
from pathlib import Path

import pytest

from fte_sniff.session.worker_process import start_worker
from tests.slow import first
from tests.waiting import BOUND_S

pytestmark = pytest.mark.program


def send_import_path(_received: FileIO, sent: FileIO) -> None:
    sent.write(json.dumps([sys.path, os.environ.get("PYTHONPATH")]).encode())


@pytest.mark.parametrize("entry", first(3, ["", ".", "{link}", "{here}", "{here}/", "x/.."]))
def test_the_working_folder_is_on_no_import_path(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch, entry: str
) -> None:
    """Whatever the environment and this process have on theirs."""
    executed = tmp_path_factory.mktemp("marker") / "executed"
    for name in ("encodings", "struct", "pickle"):
        poison = f"import posix\nposix.open({str(executed)!r}, posix.O_CREAT)\n"
        (tmp_path / f"{name}.py").write_text(poison)
    link = executed.with_name("link")
    link.symlink_to(tmp_path)
    (tmp_path / "x").mkdir()
    monkeypatch.chdir(tmp_path)
    entry = entry.format(here=tmp_path, link=link)
    monkeypatch.setenv("PYTHONPATH", f"{entry}{os.pathsep}/usr/share")
    monkeypatch.setattr(sys, "path", [entry, *sys.path])
    process = start_worker(send_import_path)
    path, variable = json.loads(process.communicate(timeout=BOUND_S)[0])
    assert process.returncode == 0
    assert tmp_path.resolve() not in {Path(one).resolve() for one in path}
    assert variable is None
    assert not executed.exists()
