"""The table of a terminal: each row is one line, and its faults are in it."""

from io import StringIO

import pytest
from rich.console import Console

from fte_sniff.formats.text_table import PlainWriter, RichWriter
from fte_sniff.protocol import Chunk, Fault, Framer, Row
from tests.support.columns import fed


@pytest.mark.parametrize("width", [60, 80, 150, 200, 5000])
@pytest.mark.parametrize("size", [3, 12, 16])
def test_long_bytes_do_not_hide_the_fault(width: int, size: int) -> None:
    row = Row(
        "port", 0, bytes(size), 1_770_000_000_000_000_000, (Fault.NOISE,), delay_ns=0, framed=False
    )
    screen = StringIO()
    RichWriter(Console(file=screen, width=width), ports=True).write([row])
    head, line = screen.getvalue().splitlines()
    assert "noise" in line
    assert max(map(len, (head, line))) <= width
    assert ("…" in line) == (" 00" * size not in f" {line}")
    assert line.index("noise") < line.index("00 00")


def test_a_file_has_all_bytes() -> None:
    row = Row("port", 0, bytes(16), None, (Fault.NOISE,), delay_ns=0, framed=False)
    file = StringIO()
    PlainWriter(file, ports=False).write([row])
    assert " ".join(["00"] * 16) in file.getvalue()


@pytest.mark.parametrize(
    ("sent", "style"),
    [
        ("AA 01 01 00 00 00 00 00 00 EE", "36"),
        ("AA 00 00 00 00 00 00 00 00 EE", "1;35"),
        ("55 01 01 00 00 00 00 00 0F EE", "39"),
        ("55 01 01 00 00 00 00 00 FF EE", "33"),
        ("55 01 01", "1;31"),
    ],
)
def test_a_row_has_the_colour_of_its_status_or_direction(sent: str, style: str) -> None:
    framer = Framer("port")
    rows = fed(framer, Chunk("port", None, bytes.fromhex(sent))) + list(framer.finish())
    screen = StringIO()
    console = Console(file=screen, width=200, force_terminal=True, color_system="standard")
    RichWriter(console, ports=False).write(rows)
    head, line = screen.getvalue().splitlines()
    assert head.startswith("\x1b[1m")
    assert line.startswith(f"\x1b[{style}m")
