"""What users rely on: the public names, and the pages of README and docs."""

import re
from importlib.metadata import metadata, version
from pathlib import Path

import pytest

import fte_sniff
from docs.links import PAGES, TOP, anchors, broken, tokens, unreached
from fte_sniff.protocol.columns import COLUMNS
from fte_sniff.protocol.spec import KINDS, Fault, Status
from tests.protocol.document import EXAMPLES


def test_public_names_are_pinned() -> None:
    assert " ".join(fte_sniff.__all__) == (
        "KINDS Chunk Fault FileError FilterError Framer FteSniffError InputTextError PortError"
        " PortEvent RecordingWarning Row Status UsageError ValueRangeError"
        " check compare encode findings read record scan stats"
    )
    assert all(hasattr(fte_sniff, name) for name in fte_sniff.__all__)
    assert dir(fte_sniff) == sorted(fte_sniff.__all__)


def test_every_module_has_a_docstring() -> None:
    silent = [
        str(path)
        for path in Path(fte_sniff.__file__).parent.rglob("*.py")
        if not path.read_text(encoding="utf-8").lstrip().startswith(('"""', 'r"""'))
    ]
    assert silent == []


def test_version_is_that_of_the_package() -> None:
    assert version("fte-sniff") == fte_sniff.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", fte_sniff.__version__)


def test_extras_that_messages_and_pages_name_exist() -> None:
    sources = [*Path(fte_sniff.__file__).parent.rglob("*.py"), *PAGES]
    texts = [path.read_text(encoding="utf-8") for path in sources]
    named = {name for text in texts for name in re.findall(r"'(?:fte-sniff|\.)\[(\w+)\]'", text)}
    assert named >= {"cluster", "foxglove", "report"}
    assert named <= set(metadata("fte-sniff").get_all("Provides-Extra", []))


def rows_of_where() -> list[str]:
    """The rows of the table "Where do I put" of CONTRIBUTING."""
    text = (TOP / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return re.findall(r"^\| an? .*\|$", text.partition("## Where do I put")[2], re.MULTILINE)


@pytest.mark.parametrize("row", rows_of_where(), ids=lambda row: row.split("|")[1].strip())
def test_where_a_new_thing_goes_exists(row: str) -> None:
    words = re.findall(r"`([\w./-]+)`", row)
    names = [word for word in words if re.search(r"[./]", word) and not re.search("[A-Z]", word)]
    places = {word: [TOP / word, TOP / "fte_sniff" / word] for word in names if "__" not in word}
    assert [word for word, paths in places.items() if not any(map(Path.exists, paths))] == []
    files = [one for paths in places.values() for one in paths if one.is_file()]
    text = "".join(one.read_text(encoding="utf-8") for one in files)
    plain = [word for word in words if re.fullmatch(r"\w+", word) and "__" not in word]
    assert [word for word in plain if not re.search(rf"\b{word}\b", text)] == []


def test_where_has_few_rows() -> None:
    assert 0 < len(rows_of_where()) <= 12


READMES = ("README.md", "README.zh-CN.md")


@pytest.mark.parametrize("page", [*READMES, "docs/reference/rows.md"])
def test_every_name_of_the_row_contract_is_explained(page: str) -> None:
    text = (TOP / page).read_text(encoding="utf-8")
    names = [column.name for column in COLUMNS]
    names += [kind.name for kind in KINDS] + [str(word) for word in (*Fault, *Status)]
    assert [name for name in names if f"`{name}`" not in text] == []


@pytest.mark.parametrize("page", [*READMES, "docs/reference/rows.md"])
def test_exit_codes_are_explained(page: str) -> None:
    numbers = re.findall(r"\d+", (TOP / page).read_text(encoding="utf-8"))
    assert {"0", "1", "2", "3", "4", "70", "130"} <= set(numbers)


@pytest.mark.parametrize("page", ["docs/capture.md", "docs/zh/capture.md"])
@pytest.mark.parametrize("words", ["adapter TX ──", "--dtr", "GND"])
def test_wiring_is_explained(page: str, words: str) -> None:
    assert words in (TOP / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", ["docs/reference/protocol.md", "docs/zh/protocol.md"])
def test_the_protocol_page_has_every_example_of_the_document(page: str) -> None:
    cells = [
        one.children[0].content
        for one in tokens((TOP / page).read_text(encoding="utf-8"))
        if one.children and one.children[0].type == "code_inline"
    ]
    frames = [text for text in cells if re.fullmatch(r"[0-9A-F]{2}( [0-9A-F]{2}){9}", text)]
    assert frames == [example.text for example in EXAMPLES]


@pytest.mark.parametrize("page", READMES)
def test_readme_is_short(page: str) -> None:
    assert len((TOP / page).read_text(encoding="utf-8").splitlines()) <= 150


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    assert [fault for path in PAGES for fault in broken(path)] == []
    assert list(unreached()) == []


def test_code_cites_headings_that_exist() -> None:
    cited = re.compile(r'(docs/[\w/.-]+\.md),\s+"([^"]+)"')
    texts = [
        (path, path.read_text(encoding="utf-8"))
        for folder in ("fte_sniff", "tests", "docs", "samples", "benchmarks")
        for path in (TOP / folder).rglob("*.py")
    ]
    found = [(path, *cite) for path, text in texts for cite in cited.findall(text)]
    assert found
    wrong = [
        (path.name, page, heading)
        for path, page, heading in found
        if _anchor(heading) not in anchors((TOP / page).read_text(encoding="utf-8"))
    ]
    assert wrong == []


def _anchor(heading: str) -> str:
    return "-".join(heading.lower().split())


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A `b`: c\n## Twice\n## Twice\n[1](#a-b-c) [2](#twice-1) [3](#no) ![4](no.png)\n"
        "[5](https://example.org/no) [6](page.md#twice) [7](page.md#no) [8][]\n"
        "\n[8]: page.md#no-2\n"
    )
    assert [fault.split(": ")[1] for fault in broken(page, tmp_path)] == [
        *("#no", "no.png", "page.md#no", "page.md#no-2")
    ]
