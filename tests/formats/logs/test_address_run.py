"""Which address of a dump follows which, in any base, and what a * between them stands for."""

from __future__ import annotations

from functools import reduce

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.formats.logs.address_run import AddressRun
from fte_sniff.formats.logs.dump_line import DumpLine, address_of, dump_line

BYTES_A_LINE = 16


def dumped(address: str, data: bytes = bytes(BYTES_A_LINE)) -> DumpLine:
    line = dump_line(f"{address}  {data.hex(' ')}", 0) if data else address_of(address, 0)
    assert line is not None
    return line


@given(
    start=st.integers(0, 1 << 20),
    sizes=st.lists(st.integers(1, 32), min_size=1, max_size=6),
    form=st.sampled_from(["08x", "016x", "07o", "07d", "08X"]),
)
def test_addresses_that_rise_by_the_bytes_of_a_line_follow(
    start: int, sizes: list[int], form: str
) -> None:
    run = AddressRun.begun(dumped(format(start, form), bytes(sizes[0])))
    for before, size in zip(sizes, [*sizes[1:], 0], strict=True):
        start += before
        after = run.with_line(dumped(format(start, form), bytes(size)))
        assert after is not None
        assert run.left_out_before(after) == 0
        run = after


@pytest.mark.parametrize("address", ["00000000", "00000008", "0000000f", "00000018", "fffffff0"])
def test_no_other_address_follows(address: str) -> None:
    assert AddressRun.begun(dumped("00000000")).with_line(dumped(address)) is None


def test_a_base_that_one_line_rules_out_stays_out() -> None:
    lines = [dumped(address) for address in ("0000000", "0000020")]
    run = AddressRun.begun(lines[0]).with_line(lines[1])
    assert run is not None
    assert set(run.starts) == {8}
    assert run.with_line(dumped("0000030")) is None
    assert run.with_line(dumped("0000040")) is not None


@pytest.mark.parametrize(
    ("addresses", "then", "left_out"),
    [
        (["00000000"], "00000010", 0),
        (["00000000"], "00000040", 3),
        (["00000000", "00000010"], "00000100", 14),
        (["0000000", "0000020"], "0000100", 2),
        (["0000000", "0000016"], "0000048", 1),
        (["0000000"], "0000320", None),
    ],
)
def test_what_a_star_stands_for(addresses: list[str], then: str, left_out: int | None) -> None:
    first, *others = map(dumped, addresses)

    def next_of(run: AddressRun, line: DumpLine) -> AddressRun:
        after = run.with_line(line)
        assert after is not None
        return after

    run = reduce(next_of, others, AddressRun.begun(first)).repeating()
    assert run.left_out_before(next_of(run, dumped(then))) == left_out


@pytest.mark.parametrize(
    ("end", "missing"),
    [("00000010", False), ("00000020", True), ("00000000", False), ("0020", False)],
)
def test_an_end_that_is_too_far_away_tells_of_missing_lines(end: str, missing: bool) -> None:
    assert AddressRun.begun(dumped("00000000")).misses_lines(dumped(end, b"")) is missing


@pytest.mark.parametrize(
    ("text", "begun"),
    [("0000", True), ("0000001", True), ("00000010", False), ("AA", False), ("00 00", False)],
)
def test_an_address_that_is_cut_short_may_be_the_next(text: str, begun: bool) -> None:
    assert AddressRun.begun(dumped("00000000")).begins_next(text, 0) is begun
