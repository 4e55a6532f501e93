"""The console sessions in `sessions/`: each command prints what a user is shown there."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import console
from tests.in_process import user_environment

FILES = sorted(Path(__file__).with_name("sessions").glob("*.md"))
ALL = [
    pytest.param(
        path,
        one,
        id=f"{path.stem}: {one.heading[3:]}",
        marks=[getattr(pytest.mark, name) for name in one.needs],
    )
    for path in FILES
    for one in console.sessions_of(path)[1:]
]


@pytest.mark.parametrize(("path", "session"), ALL)
def test_session(
    path: Path,
    session: console.Session,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    request: pytest.FixtureRequest,
) -> None:
    environment = user_environment(tmp_path_factory.mktemp("home"))
    bless = bool(request.config.getoption("--bless"))
    console.play(session, tmp_path, environment, bless=bless)
    if bless:
        console.replace_session(path, session)
