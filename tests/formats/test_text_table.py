"""The table of a terminal: each row is one line, and its faults are in it."""

from io import StringIO

import pytest

from fte_sniff.formats.text_table import TableWriter
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import Fault
from tests.support.columns import fed


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("width", [60, 80, 150, 200, 5000])
@pytest.mark.parametrize("size", [3, 12, 16])
def test_long_bytes_do_not_hide_the_fault(
    width: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("NO_COLOR", "1")
    row = Row(
        "port", 0, bytes(size), 1_770_000_000_000_000_000, (Fault.NOISE,), delay_ns=0, framed=False
    )
    screen = Terminal()
    TableWriter(screen, ports=True)([row])
    head, line = screen.getvalue().splitlines()
    assert "noise" in line
    assert max(map(len, (head, line))) <= width
    assert ("…" in line) == (" 00" * size not in f" {line}")
    assert line.index("noise") < line.index("00 00")


def test_a_file_has_all_bytes() -> None:
    row = Row("port", 0, bytes(16), None, (Fault.NOISE,), delay_ns=0, framed=False)
    file = StringIO()
    TableWriter(file, ports=False)([row])
    assert " ".join(["00"] * 16) in file.getvalue()


@pytest.mark.parametrize(
    ("sent", "style"),
    [
        ("AA 01 01 00 00 00 00 00 00 EE", "\x1b[36m"),
        ("AA 00 00 00 00 00 00 00 00 EE", "\x1b[35m\x1b[1m"),
        ("55 01 01 00 00 00 00 00 0F EE", " "),
        ("55 01 01 00 00 00 00 00 FF EE", "\x1b[33m"),
        ("55 01 01", "\x1b[31m\x1b[1m"),
    ],
)
def test_a_row_has_the_colour_of_its_status_or_direction(
    sent: str, style: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    framer = Framer("port")
    rows = fed(framer, Chunk("port", None, bytes.fromhex(sent))) + list(framer.finish())
    screen = Terminal()
    TableWriter(screen, ports=False)(rows)
    head, line = screen.getvalue().splitlines()
    assert head.startswith("\x1b[1m")
    assert line.startswith(style)
