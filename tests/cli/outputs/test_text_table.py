"""Tables of text: whole where there is room, narrower by shorter names and fewer columns."""

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from fte_sniff.cli.stats_report import LEAST_NAME, TextTable

WORDS = st.text(st.sampled_from("ab/ 测é"), max_size=40)
CELLS = st.text(st.sampled_from("019.,msµ–"), max_size=12)


def table_of(lines: list[list[str]]) -> TextTable:
    table = TextTable(lines[0])
    for line in lines[1:]:
        table.append(line, mark="! ")
    return table


@st.composite
def tables(draw: st.DrawFn) -> list[list[str]]:
    columns = draw(st.integers(1, 5))
    line = st.tuples(WORDS, *[CELLS] * columns).map(list)
    return draw(st.lists(line, min_size=2, max_size=6))


@given(tables())
def test_without_a_width_nothing_is_cut(lines: list[list[str]]) -> None:
    reported = [text.plain for text in table_of(lines).lines(None)]
    assert len(reported) == len(lines)
    for text, cells in zip(reported, lines, strict=True):
        for cell in cells:
            assert cell.strip() in text


@given(tables(), st.integers(40, 120))
def test_it_keeps_to_the_width(lines: list[list[str]], width: int) -> None:
    reported = [text.plain for text in table_of(lines).lines(width)]
    assert max(map(cell_len, reported)) <= width
    assert len(reported) == len(lines)


def test_names_are_shortened_before_columns_are_left_out() -> None:
    lines = [["file", "rows", "bytes"], ["logs/" + "x" * 60 + "/end.mcap", "1,000", "10,000"]]
    head, line = (text.plain for text in table_of(lines).lines(50))
    assert line.endswith("end.mcap  1,000  10,000")
    assert head.endswith(" rows   bytes")
    head, line = (text.plain for text in table_of(lines).lines(LEAST_NAME + 10))
    assert "bytes" not in head
    assert line.endswith("end.mcap  1,000")
