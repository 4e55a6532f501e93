"""Lines of any text, in bounded memory; blocks of NUL are reported."""

from __future__ import annotations

import io
import tracemalloc
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.formats.logs import text as log_text
from fte_sniff.formats.logs.text import NulBlock, TextBlock
from tests.slow import first

LINE = "[12:00:00.123] Recv: 55 01 01 03 E8 00 00 00 0F EE\n"


class Reads(io.BytesIO):
    """A stream whose reads return at most the given numbers of bytes, and then whole blocks."""

    def __init__(self, data: bytes, sizes: list[int]) -> None:
        super().__init__(data)
        self.sizes = sizes

    def read1(self, size: int | None = -1, /) -> bytes:
        return super().read(self.sizes.pop() if self.sizes else size)


@given(
    st.sampled_from(["utf-8", "utf-16-le", "utf-16-be"]),
    st.lists(st.tuples(st.integers(0, 3), st.integers(8, 300)), min_size=1, max_size=6),
    st.lists(st.integers(1, 400), max_size=20),
    st.booleans(),
)
@example("utf-16-le", [(3, 8), (0, 8)], [103], False)
@example("utf-16-le", [(3, 8), (0, 8)], [104], False)
@example("utf-16-be", [(3, 8), (0, 8)], [*[1] * 10, 109], False)
def test_a_block_of_nul_ends_a_line_and_is_reported_whatever_the_reads(
    encoding: str, blocks: list[tuple[int, int]], sizes: list[int], has_end: bool
) -> None:
    content, lines, expected = b"", list[bytes](), list[NulBlock]()
    for number, (count, nuls) in enumerate(blocks):
        texts = [f"{number}: {at} AA 01 €" for at in range(count + 1)]
        text = "\n".join(texts) + "\n" * (has_end and number == len(blocks) - 1)
        content += text.encode(encoding)
        lines += [one.encode() for one in texts]
        if number < len(blocks) - 1:
            # The bytes of the characters beside a block may be NUL too.
            before, after = encoding == "utf-16-le" and text[-1] < "€", encoding == "utf-16-be"
            expected.append(NulBlock(len(content) - before, 2 * nuls + before + after))
            content += bytes(2 * nuls)
    found = list(log_text.text_blocks(Reads(content, sizes)))
    assert [line for block in found for line in block.lines] == lines
    assert [block.skipped for block in found if block.skipped] == expected


def test_lines_keep_their_numbers_after_a_block_of_nul() -> None:
    data = b"one\ntwo" + bytes(1000) + b"two, further\nthree\n"
    found = list(log_text.text_blocks(io.BytesIO(data)))
    assert [(block.first, block.text, block.skipped) for block in found] == [
        (1, b"one\n", None),
        (2, b"two\n", None),
        (2, b"", NulBlock(7, 1000)),
        (2, b"two, further\nthree\n", None),
    ]


def test_a_few_nul_within_a_text_are_removed() -> None:
    found = list(log_text.text_blocks(io.BytesIO(b"AA\0 01\0\0\n\0\0\0BB\n")))
    assert found == [TextBlock(b"AA 01\nBB\n")]


@given(st.integers(0, 40), st.integers(1, 3))
def test_escape_sequences_are_removed_wherever_a_long_line_is_cut(lead: int, colours: int) -> None:
    data = b"x" * lead + b"\x1b[0;31m\x1b[0m\x1bMAA 01 " * 20_000 * colours
    found = list(log_text.text_blocks(io.BytesIO(data)))
    assert b"".join(block.text for block in found) == b"x" * lead + b"AA 01 " * 20_000 * colours + (
        b"\n"
    )


def peak_of(data: bytes) -> int:
    """Most memory while the lines of a stream are read, beside the stream."""
    stream = io.BytesIO(data)
    tracemalloc.start()
    try:
        for block in log_text.text_blocks(stream):
            del block
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


SIZE = 3 << 20


@cache
def peak_of_lines(line: bytes) -> int:
    return peak_of(line * (SIZE // len(line)))


@pytest.mark.parametrize(
    "hostile",
    [(bytes(256) + b"x") * (SIZE // 257), LINE.encode() * 9 + bytes(SIZE)],
    ids=["blocks of zeros", "a log with a block of zeros"],
)
def test_a_block_of_nul_takes_no_more_memory_than_lines(hostile: bytes) -> None:
    assert peak_of(hostile) < 2 * peak_of_lines(LINE.encode())


@pytest.mark.parametrize(
    "unit", first(3, [b"\x1bM", b"\0x", "收".encode("gbk"), b"\x1b[0m", b"x\x1b[K"])
)
def test_a_very_long_line_takes_no_more_memory_than_another(unit: bytes) -> None:
    assert peak_of(unit * (SIZE // len(unit))) < 3 * peak_of_lines(b"x")


def test_a_sample_has_whole_lines_from_four_evenly_spaced_blocks(tmp_path: Path) -> None:
    path = tmp_path / "long.txt"
    path.write_text("".join(f"{number:09}\n" for number in range(30_001)))
    found = [int(line) for line in log_text.sample(path)]
    starts = [found[0], *(later for one, later in pairwise(found) if later != one + 1)]
    assert [round(start / 30_001, 1) for start in starts] == [0, 0.3, 0.6, 1]
    assert found[-1] == 30_000
    assert len(found) == pytest.approx(4 * 1024, abs=8)
