"""What `import fte_sniff` promises, and what the house looks like from outside."""

from importlib.metadata import version
from pathlib import Path

import fte_sniff


def test_public_names_are_pinned() -> None:
    assert fte_sniff.__all__ == [
        "KINDS",
        "Chunk",
        "Damage",
        "Fault",
        "FileError",
        "FilterError",
        "Frame",
        "Framer",
        "FteSniffError",
        "InputTextError",
        "PortError",
        "PortEvent",
        "RecordingWarning",
        "Row",
        "Status",
        "UsageError",
        "ValueRangeError",
        "encode",
        "read",
        "record",
        "scan",
    ]
    assert all(hasattr(fte_sniff, name) for name in fte_sniff.__all__)


def test_every_room_says_what_it_owns_and_what_it_must_not_know() -> None:
    silent = [
        str(path)
        for path in Path(fte_sniff.__file__).parent.rglob("*.py")
        if not path.read_text(encoding="utf-8").lstrip().startswith(('"""', 'r"""'))
    ]
    assert silent == []


def test_version_is_that_of_the_package() -> None:
    assert version("fte-sniff").count(".") == 2
