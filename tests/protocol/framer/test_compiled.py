"""The compiled framer is of the present source, and gives the same rows as the source.

    python -m tests.protocol.framer.test_compiled --interpreted [--by-scores]

prints the rows of the interpreted source; with `--by-scores`, of a source that decodes all disputed
bytes, unambiguous frames too. (Compiled functions call each other, and cannot be replaced.)
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest

from tests.framer_form import PACKAGE, form_error, interpret
from tests.waiting import BOUND_S

ROOT = Path(__file__).parents[3]

SHARES = {"ordinary": 0.2, "hostile": 0.5}
"""By payload: the share of damaged frames."""
FRAMES = 300


def rows_as_text() -> list[str]:
    """Every row of the named cases and of some damaged streams."""
    from fte_sniff.protocol import Chunk, Framer

    lines = []
    for stream in _streams():
        for size in (7, len(stream)):
            framer = Framer("p")
            rows = []
            for number, at in enumerate(range(0, len(stream), size)):
                t_ns = 10**18 + number * 4_000_000
                rows += framer.feed(Chunk("p", t_ns, stream[at : at + size]))
            lines += [repr(row) for row in rows + framer.flush()]
    return lines


def _streams() -> Iterator[bytes]:
    from tests.protocol.framer.test_framer import CASES
    from tests.support.faults import damaged_stream

    for case in CASES.values():
        yield b"".join(bytes.fromhex(piece) for piece, _ in case)
    for payload, share in SHARES.items():
        yield damaged_stream(1, FRAMES, share, payload)[0]
    yield Random(9).randbytes(2000)
    yield bytes(Random(11).choices(b"\xaa\x55\xee\x00\x01", k=600))


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=BOUND_S, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("how", [(), ("--by-scores",)], ids=["as it is", "by scores"])
def test_the_interpreted_source_gives_the_same_rows(how: tuple[str, ...]) -> None:
    done = run("tests.protocol.framer.test_compiled", "--interpreted", *how)
    assert not done.returncode, done.stderr
    form, *rows = done.stdout.splitlines()
    assert form == "interpreted"
    assert rows == rows_as_text()


def test_a_compiled_framer_of_another_source_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith(f"{PACKAGE}.sources_")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, f"{PACKAGE}.sources_0__mypyc", sys)
    error = form_error({})
    assert error == "the compiled framer is of another source: run: pip install -e ."


@pytest.mark.parametrize(
    ("environment", "refused"),
    [
        ({}, False),
        ({"CI": "true"}, True),
        ({"CI": "true", "FTE_SNIFF_COMPILED": "0"}, False),
        ({"FTE_SNIFF_COMPILED": "1"}, True),
    ],
)
def test_a_framer_that_is_not_compiled_is_refused_where_it_has_to_be(
    environment: dict[str, str], refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith(f"{PACKAGE}.sources_")]:
        monkeypatch.delitem(sys.modules, name)
    assert (form_error(environment) is not None) is refused


if __name__ == "__main__":
    if "--interpreted" in sys.argv:
        interpret()
    if "--by-scores" in sys.argv:
        import fte_sniff.protocol.framer.framer as module

        module.find_unambiguous = lambda *_: -1
    from fte_sniff.protocol.framer import COMPILED

    print("compiled" if COMPILED else "interpreted", *rows_as_text(), sep="\n")
