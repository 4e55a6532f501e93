"""Each row of CONTRIBUTING's "Where do I put ..." is enough: what it adds appears everywhere.

A recipe may edit only the files that its row names (`recipe.py`). The gate tests the recipes of
what is added most; the others are slow.
"""

from __future__ import annotations

import json
import re
import zlib
from base64 import b64decode

import pytest

from tests.recipes.recipe import Copy, Recipe

FRAMES = bytes.fromhex("AA010103E800000000EE AA020203E800002710EE 55010103E80000000FEE")
SPEED = bytes.fromhex("AA010103E800000000EE")


def write(copy: Copy, name: str, data: bytes | str) -> str:
    """A file in the folder of the commands."""
    path = copy.folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return name


def rows_of(copy: Copy, *words: str) -> list[dict[str, object]]:
    """The rows that `decode` writes as JSON lines."""
    output = copy.run("decode", *words, "--format", "jsonl")
    return [json.loads(line) for line in output.splitlines()]


def test_kind_of_frame(recipe: Recipe) -> None:
    recipe.before(
        "fte_sniff/protocol/spec.py",
        ')\n"""Every kind of frame',
        """    FrameKind(
        "lamp",
        Direction.CONTROL,
        (0x04,),
        (_MOTOR, _int16("glow", 3, "lm", "brightness of a lamp", "glow", None)),
        range(5, 9),
        "light a lamp",
    ),
""",
    )
    lamp = "AA 04 02 00 28 00 00 00 00 EE"
    with recipe.program() as copy:
        assert copy.run("encode", "lamp", "--motor", "2", "--glow", "40") == f"{lamp}\n"
        assert "lamp" in copy.run("hex", lamp)
        raw = write(copy, "a.raw", bytes.fromhex(lamp) * 300 + FRAMES)
        expected = {"kind": "lamp", "motor": 2, "glow": 40, "status": "ok"}
        for words in ((raw,), (raw, "--limit", "1"), (raw, "--filter", "kind = 'lamp'")):
            rows = rows_of(copy, *words)
            assert expected.items() <= rows[0].items()
        copy.run("decode", raw, "--start", "2026-01-31T12:00:00Z", "-o", "a.mcap")
        recorded = rows_of(copy, "a.mcap", "--filter", "glow > 39")
        assert len(recorded) == 300
        assert expected.items() <= recorded[-1].items()
        assert len(rows_of(copy, "samples/clean.mcap")) > 100
        assert "glow=40" in copy.run("decode", raw, "--limit", "1")
        assert "lamp 2 " in copy.run("stats", "a.mcap")
        assert "40 .. 40" in copy.run("stats", "a.mcap")
        copy.run("check", "a.mcap", "--expect", "max(glow) == 40")
        copy.run("report", "a.mcap", "-o", "a.html")
        assert "lamp" in (copy.folder / "a.html").read_text()
        copy.run("live", "sim://?seed=1", "--plain", "--count", "20", "-o", "b.mcap")
        assert "light a lamp" in copy.screen(raw, "home", "i", "M", "S")
        assert "glow" in copy.page_part("kinds") + copy.page_part("headers")
        assert "brightness of a lamp" in copy.page_part("fields")


def test_form_of_writing_bytes_in_logs(recipe: Recipe) -> None:
    logs = "fte_sniff/formats/logs"
    recipe.before(
        f"{logs}/evidence.py",
        '    ("base64", ',
        '    ("tilde before each byte", "~@@", " ?", "a tool of this test"),\n',
    )
    recipe.before(
        f"{logs}/times.py",
        '    ("since", 0, _NUMBER),',
        '    ("since", 10**6, r"tick " + _NUMBER),\n',
    )
    recipe.replace(f"{logs}/evidence.py", r"(?:tx\d?|txd|", r"(?:north|tx\d?|txd|")
    with recipe.program() as copy:
        for between in ("", " "):
            line = between.join(f"~{byte:02x}" for byte in SPEED)
            log = "".join(
                f"tick {100 * number} {'RX' if number % 3 else 'north'} {line}\n"
                for number in range(30)
            )
            rows = rows_of(copy, write(copy, "a.log", log), "--start", "2026-01-31T12:00:00Z")
            assert {row["raw"] for row in rows} == {SPEED.hex().upper()}
            assert [str(row["time"])[17:21] for row in rows[:3]] == ["00.0", "00.1", "00.2"]
            assert [row["port"] for row in rows[:3]] == ["a.log:tx", "a.log:rx", "a.log:rx"]


def test_column(recipe: Recipe) -> None:
    recipe.before(
        "fte_sniff/protocol/columns.py",
        '    Column(\n        "answer_ms",',
        """    Column(
        "bits",
        ColumnType.INT,
        "bits of the row",
        lambda row: 8 * len(row.raw),
        lambda rows: ColumnData(8 * rows.length),
        unit="bit",
        rank=11,
    ),
""",
    )
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES * 200)
        few = copy.run("decode", raw, "--format", "csv", "--limit", "2").splitlines()
        many = copy.run("decode", raw, "--format", "csv").splitlines()
        at = few[0].split(",").index("bits")
        assert [line.split(",")[at] for line in few] == ["bits", "80", "80"]
        assert [line.split(",")[at] for line in many] == ["bits", *["80"] * 600]
        for form in ("csv", "jsonl"):
            copy.run("decode", raw, "-o", f"a.{form}")
            again = copy.run("decode", f"a.{form}", "--format", "hex")
            assert again == copy.run("decode", raw, "--format", "hex")
        for words in (("--limit", "2"), (), ("--filter", "bits = 80")):
            assert {row["bits"] for row in rows_of(copy, raw, *words)} == {80}
        copy.run("decode", raw, "-o", "a.parquet")
        assert rows_of(copy, "a.parquet")[0]["raw"] == SPEED.hex().upper()
        assert copy.complete("fte-sniff decode --filter bi")[0] == "bits"
        copy.run("check", raw, "--expect", "max(bits) == 80")
        assert "80 bit" in copy.run("check", raw, "--expect", "max(bits) == 8", code=1)
        screen = copy.screen(raw, "C")
        assert "bits" in screen.splitlines()[1].split()
        assert "bits of the row" in screen
        assert "| `bits` | int | bits of the row |" in copy.page_part("rows")
        assert "bits of the row" in copy.unfinished_texts()


@pytest.mark.slow
def test_output_format(recipe: Recipe) -> None:
    writers = "fte_sniff/formats/writers.py"
    recipe.after(writers, '    TABLE = "table"', '    TABS = "tabs"\n')
    recipe.after(
        writers, '        ".csv": OutputFormat.CSV,', '        ".tabs": OutputFormat.TABS,\n'
    )
    recipe.replace(
        writers,
        "TEXT_FORMATS = (OutputFormat.TABLE,",
        "TEXT_FORMATS = (OutputFormat.TABLE, OutputFormat.TABS,",
    )
    recipe.before(
        writers,
        "    if form is OutputFormat.JSONL:\n",
        "    if form is OutputFormat.TABS:\n        return TabsWriter(stream)\n",
    )
    recipe.append(
        writers,
        '''

class TabsWriter(_LineWriter):
    """Writes the values of a row with tabs between two."""

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""
        self._stream.writelines("\\t".join(map(str, record(row).values())) + "\\n" for row in rows)
''',
    )
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES * 200)
        output = copy.run("decode", raw, "--format", "tabs")
        assert len(output.splitlines()) == 600
        assert FRAMES[20:].hex().upper() in output.splitlines()[-1].split("\t")
        copy.run("decode", raw, "-o", "a.tabs")
        assert (copy.folder / "a.tabs").read_text() == output
        assert "\t" in copy.run("hex", SPEED.hex(), "--format", "tabs")
        assert copy.complete("fte-sniff decode --format ta") == ["table", "tabs"]
        assert all("tabs" in copy.run(name, "--help") for name in ("decode", "hex"))
        keys = ("w", *"b.tabs", "enter")
        assert "b.tabs" in copy.screen(raw, *keys)


@pytest.mark.slow
def test_way_to_get_bytes(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/capture/repeated.py",
        '''"""A frame that comes again and again, without a port."""

from dataclasses import dataclass

from fte_sniff.capture.serial_port import DEFAULT_SETTINGS, PortSettings
from fte_sniff.capture.source import SourceEnd
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

FRAME = bytes.fromhex("AA010103E800000000EE")


@dataclass(frozen=True)
class Repeated:
    """The frame as a port."""

    settings: PortSettings = DEFAULT_SETTINGS
    names = ("repeated",)

    def open(self, clock):
        """Open the source."""
        return RepeatedSource(clock)


class RepeatedSource:
    """The frame, nine times."""

    end = device = None
    waiting = 0

    def __init__(self, clock):
        self._clock = clock
        self.uncertainty_ns, self.capabilities = {"repeated": 0}, {"repeated": "repeats"}

    def __iter__(self):
        yield PortEvent(self._clock.now_ns(), "repeated", PortEventKind.OPENED, "it repeats")
        for _ in range(9):
            yield Chunk("repeated", self._clock.now_ns(), FRAME)
        self.end = SourceEnd.STOPPED

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        pass

    def close(self):
        """Nothing is open."""

    stop = drop = close

    def stop_at(self, t_ns):
        """It ends soon."""
''',
    )
    live = "fte_sniff/cli/live.py"
    recipe.before(
        live, "@capture_options\n", '@click.option("--repeated", is_flag=True, help="Repeat it.")\n'
    )
    recipe.after(live, "    attach: bool,", "    repeated: bool,\n")
    recipe.before(
        live,
        "        from fte_sniff.capture.port_source import PortGroup\n",
        """        if repeated:
            from fte_sniff.capture.repeated import Repeated

            return Repeated(settings)
""",
    )
    with recipe.program() as copy:
        words = ("live", "any", "--repeated", "--plain", "-o", "a.mcap")
        assert copy.run(*words).count("rpm=1000") == 9
        rows = rows_of(copy, "a.mcap")
        assert [(row["port"], row["rpm"], row["offset"]) for row in rows] == [
            ("repeated", 1000, offset) for offset in range(0, 90, 10)
        ]
        assert "--repeated" in copy.page_part("commands")


@pytest.mark.slow
def test_reader_of_live_rows(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/cli/row_count.py",
        '''"""The number of rows of a capture, in a file."""

from fte_sniff.cli.capture_loop import Observer


class RowCountFile(Observer):
    """Counts the rows, and writes their number at the end."""

    def __init__(self, path):
        self._path, self._rows = path, 0

    def update(self, update, session):
        """Count rows."""
        self._rows += len(update.rows)

    def ended(self, session):
        """Write the number."""
        self._path.write_text(f"{self._rows} rows")
''',
    )
    command = "fte_sniff/cli/capturing.py"
    recipe.before(
        command,
        """    click.option(
        "--udp",
""",
        """    click.option("--row-count", type=FileName(), help="Write the number of rows."),\n""",
    )
    recipe.after(command, "    udp: str | None,", "    row_count: Path | None,\n")
    recipe.before(
        command,
        "    if udp is not None:\n",
        """    if row_count is not None:
        from fte_sniff.cli.row_count import RowCountFile

        observers = [*observers, RowCountFile(row_count)]
""",
    )
    with recipe.program() as copy:
        for way in ("--plain", "--headless"):
            words = ("live", "sim://?seed=1", way, "--count", "20", "-o", f"a{way}.mcap")
            copy.run(*words, "--row-count", "rows")
            assert (copy.folder / "rows").read_text() == "20 rows"
        assert "Write the number of rows." in copy.run("bridge", "--help")
        assert "--row-count" in copy.page_part("commands")


@pytest.mark.slow
def test_url_scheme_of_ports(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/capture/url_handlers/protocol_echo.py",
        '''"""`echo://BYTES`: a port on which these bytes come."""

from urllib.parse import urlsplit

from serial.urlhandler import protocol_loop


class Serial(protocol_loop.Serial):
    """A port that receives the bytes of its name."""

    def from_url(self, url: str) -> None:
        """Take the bytes."""
        self._bytes = bytes.fromhex(urlsplit(url).netloc)

    def open(self) -> None:
        """Receive the bytes."""
        super().open()
        self.write(self._bytes)
''',
    )
    folder = "fte_sniff/capture/url_handlers/__init__.py"
    recipe.before(
        folder, "    protocol_rfc2217  ", "    protocol_echo     The bytes of its name.\n"
    )
    recipe.before(folder, '    "socket": ', '    "echo": UrlScheme(sets_lines=True),\n')
    with recipe.program() as copy:
        port = f"echo://{SPEED.hex()}"
        copy.run("live", port, "--dtr", "leave", "--plain", code=3)
        assert "rpm=1000" in copy.run("live", port, "--plain", "--count", "1", "-o", "a.mcap")
        assert [row["port"] for row in rows_of(copy, "a.mcap")] == [port]


@pytest.mark.slow
def test_decoder_for_another_tool(recipe: Recipe) -> None:
    recipe.before(
        "fte_sniff/formats/decoders.py",
        """        "sigrok": Tool(""",
        """        "names": Tool(lambda: str(KINDS), None, "read it"),\n""",
    )
    with recipe.program() as copy:
        assert "'mecanum'" in copy.run("decoder", "names")
        assert copy.complete("fte-sniff decoder na") == ["names"]
        assert "names" in copy.run("decoder", "--help") + copy.page_part("commands")


@pytest.mark.slow
def test_command(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/cli/greet.py",
        '''"""`fte-sniff greet`."""

import click


@click.command(name="greet", short_help="Greet the user.")
def command() -> None:
    """Greet the user of the program."""
    click.echo("hello")
''',
    )
    recipe.replace("fte_sniff/cli/main.py", '("live", "view", ', '("live", "greet", "view", ')
    recipe.before("fte_sniff/cli/__init__.py", "    hex   ", "    greet         Greet the user.\n")
    recipe.replace("pyproject.toml", '"live | bridge | view', '"live | greet | bridge | view')
    with recipe.program() as copy:
        assert copy.run("greet") == "hello\n"
        assert "Greet the user." in copy.run("--help")
        assert "Greet the user of the program." in copy.run("greet", "--help")
        assert copy.complete("fte-sniff gr") == ["greet"]
        assert "## greet" in copy.page_part("commands")


def test_key_of_the_screen(recipe: Recipe) -> None:
    recipe.after(
        "fte_sniff/tui/commands.py",
        "MOVING: tuple[Command, ...] = (",
        """    _key(
        "D", "table.greet", "greet the user", short="Greet", rank=1, words="hello"
    ),
""",
    )
    recipe.before(
        "fte_sniff/tui/table.py",
        "    def action_times(self)",
        """    def action_greet(self) -> None:
        self._notice.inform("welcome")

""",
    )
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES)
        screen = copy.screen(raw, "D", "ctrl+p", *"hello", "escape", "question_mark")
        before, palette, help_page = re.split("type to find|Keys and signs", screen, maxsplit=2)
        assert "D Greet" in before
        assert "welcome" in before
        assert "greet the user" in palette
        assert "greet the user" in help_page
        assert "| `D` | greet the user |" in copy.page_part("keys")
        assert "greet the user" in copy.unfinished_texts()


@pytest.mark.slow
def test_pane_of_the_screen(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/tui/panes/greeting.py",
        '''"""A pane that greets."""

from rich.text import Text

from fte_sniff.tui.panes.pane import Pane, PaneContext


class GreetingPane(Pane):
    """Greets the user."""

    NAME = "greeting"

    def draw(self, context: PaneContext) -> None:
        """Greet."""
        self.set_title("greeting")
        self.set_page(Text(f"welcome to row {context.row_number}"))
''',
    )
    switcher = "fte_sniff/tui/panes/switcher.py"
    recipe.before(
        switcher,
        "from fte_sniff.tui.panes.motors ",
        "from fte_sniff.tui.panes.greeting import GreetingPane\n",
    )
    recipe.replace(switcher, "*(DetailPane, ", "*(GreetingPane, DetailPane, ")
    recipe.after(
        "fte_sniff/tui/commands.py",
        "UNDERSTANDING: tuple[Command, ...] = (",
        """    _rows("D", "panes.switch('greeting')", "a greeting"),\n""",
    )
    recipe.append("fte_sniff/tui/panes/__init__.py", "")
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES)
        screen = copy.screen(raw, "home", "D", "question_mark")
        assert "welcome to row 1" in screen
        assert "a greeting" in screen


@pytest.mark.slow
def test_model_or_number_that_the_screen_shows(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/analysis/longest.py",
        '''"""The longest row."""

from fte_sniff.protocol import Rows


class LongestRow:
    """Bytes of the longest row."""

    def __init__(self) -> None:
        self.bytes = 0

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        self.bytes = max(self.bytes, int(rows.length.max()))
''',
    )
    models = "fte_sniff/analysis/live_models.py"
    recipe.before(
        models,
        "from fte_sniff.analysis.motors import FlagCounts",
        "from fte_sniff.analysis.longest import LongestRow\n",
    )
    recipe.before(models, "        self.missed = 0\n", "        self.longest = LongestRow()\n")
    recipe.after(
        models,
        "                self.statistics.observe(rows)",
        "                self.longest.observe(rows)\n",
    )
    recipe.before(
        "fte_sniff/tui/panes/statistics.py",
        "        ports, streams = ",
        "        yield Text(f'longest row: {models.longest.bytes} bytes')\n",
    )
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES)
        assert "longest row: 10 bytes" in copy.screen(raw, "S")


def test_measure_of_check(recipe: Recipe) -> None:
    measures = "fte_sniff/analysis/measures.py"
    table = "MEASURES: Final[Mapping[str, MeasureKind]] = {"
    recipe.after(
        measures,
        table,
        """    "volume": MeasureKind(
        _Volume, Argument.FILTER, "volume(malformed) == 0", "a row", "bytes"
    ),
""",
    )
    recipe.before(
        measures,
        table,
        '''class _Volume(Measure):
    """`volume(FILTER)`."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._bytes = 0

    def observe(self, rows: Rows, matches: Bools) -> None:
        self._bytes += int(rows.length[matches].sum())

    def merge(self, later: Self) -> None:
        super().merge(later)
        self._bytes += later._bytes

    def value(self, total: RowCount) -> float | None:
        """The bytes of matching rows."""
        return self._bytes


''',
    )
    recipe.after(
        "docs/check.md",
        "| measure | value | needs |\n|---|---|---|",
        "| `volume(FILTER)` | bytes of matching rows | any row |\n",
    )
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES)
        copy.run("check", raw, "--expect", "volume(kind = 'speed') == 10")
        rule = ("--expect", "volume(kind = 'speed') == 10")
        failed = copy.run("check", raw, raw, "--jobs", "2", *rule, code=1)
        assert "20 bytes" in failed
        found = json.loads(copy.run("check", raw, "--format", "json", *rule))
        assert found["rules"][0]["measured"] == 10
        rules = write(copy, "a.toml", '[[rule]]\nname = "a"\nexpect = "volume(malformed) == 0"\n')
        copy.run("check", raw, "--rules", rules)


@pytest.mark.slow
def test_number_of_stats(recipe: Recipe) -> None:
    recipe.append(
        "fte_sniff/analysis/longest.py",
        '''"""The longest row."""

from typing import Self

from fte_sniff.protocol import Rows


class LongestRow:
    """Bytes of the longest row."""

    def __init__(self) -> None:
        self.bytes = 0

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        self.bytes = max(self.bytes, int(rows.length.max()))

    def merge(self, later: Self) -> None:
        """Add the rows that follow."""
        self.bytes = max(self.bytes, later.bytes)
''',
    )
    summary = "fte_sniff/analysis/statistics.py"
    recipe.before(
        summary,
        "from fte_sniff.analysis.motors import",
        "from fte_sniff.analysis.longest import LongestRow\n",
    )
    recipe.before(
        summary, "        self.flags = FlagCounts()\n", "        self.longest = LongestRow()\n"
    )
    recipe.after(
        summary,
        "        self.flags.merge(later.flags)",
        "        self.longest.merge(later.longest)\n",
    )
    recipe.after(
        summary,
        "        self.flags.observe(rows, found)",
        "        self.longest.observe(rows)\n",
    )
    recipe.after(
        "fte_sniff/session/stats_json.py",
        '        "version": VERSION,',
        '        "longest_row_bytes": summary.longest.bytes,\n',
    )
    recipe.before(
        "fte_sniff/cli/stats.py",
        "    for selection in reading.selections:\n",
        '    yield _line("longest", f"{summary.longest.bytes} bytes")\n',
    )
    recipe.append("docs/stats.md", "\n`longest_row_bytes` is the length of the longest row.\n")
    with recipe.program() as copy:
        short, long = write(copy, "a.raw", FRAMES), write(copy, "b.raw", FRAMES + bytes(30))
        assert "longest    10 bytes\n" in copy.run("stats", short)
        for jobs in ("1", "2"):
            words = ("stats", long, short, "--format", "json", "--jobs", jobs)
            assert json.loads(copy.run(*words))["longest_row_bytes"] == 30


@pytest.mark.slow
def test_page_of_documentation(recipe: Recipe) -> None:
    recipe.append("docs/greeting.md", "# A greeting\n\nWelcome.\n")
    check = (
        "import os, runpy; runpy.run_path(os.path.abspath('docs/links.py'), run_name='__main__')"
    )
    with recipe.program() as copy:
        assert "docs/index.md has no link to it" in copy.python(check, code=1)
        recipe.append("docs/index.md", "\n- [A greeting](greeting.md): welcome\n")
        assert not copy.python(check)


@pytest.mark.slow
def test_check_of_doctor(recipe: Recipe) -> None:
    doctor = "fte_sniff/session/doctor.py"
    recipe.after(
        doctor,
        '    """Check folder, terminal, installation, clock, and programs that interfere."""',
        "    yield greeting_finding()\n",
    )
    recipe.append(
        doctor,
        '''

def greeting_finding() -> Diagnosis:
    """That nobody was greeted."""
    return bad("user", "nobody was greeted", "say hello")
''',
    )
    with recipe.program() as copy:
        output = copy.run("doctor", code=1)
        assert "nobody was greeted" in output
        assert "say hello" in output
        assert "nobody was greeted" in copy.run("doctor", "sim://", "--seconds", "0.1", code=1)
        found = map(json.loads, copy.run("doctor", "--format", "jsonl", code=1).splitlines())
        assert "nobody was greeted" in [one["what"] for one in found]


@pytest.mark.slow
def test_filter_function(recipe: Recipe) -> None:
    recipe.after(
        "fte_sniff/analysis/filter/terms.py",
        "FUNCTIONS: Final = {",
        """    "twice": Function(
        (TermType.NUMBER,), TermType.NUMBER, lambda number: 2 * number, "twice(rpm) > 500"
    ),
""",
    )
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES)
        assert len(rows_of(copy, raw, "--filter", "twice(rpm) = 2000")) == 3
        copy.run("check", raw, "--expect", "count(twice(rpm) = 2000) == 3")
        assert copy.complete("fte-sniff decode --filter tw") == ["twice("]
        assert "twice(rpm) > 500" in copy.run("decode", "--filter", "help")
        assert "twice(rpm) > 500" in copy.screen(raw, "question_mark", "end")


@pytest.mark.slow
def test_look_of_a_status(recipe: Recipe) -> None:
    look = "fte_sniff/protocol/columns.py"
    for old, new in (('"!"', "§"), ('"#d03b3b"', "#123456"), ('Ink("#a33c00"', "#654321")):
        recipe.replace(look, old, re.sub('".*"', f'"{new}"', old))
    with recipe.program() as copy:
        few = write(copy, "a.raw", FRAMES + b"\0\0\0" + FRAMES)
        many = write(copy, "b.raw", FRAMES * 99 + b"\0\0\0" + FRAMES)
        texts = [copy.run("decode", few), copy.run("decode", many), copy.run("stats", many)]
        texts.append(copy.screen(many, "e", "i", "S"))
        # A warning and the key of the findings have a `!` that is not the look of a status.
        other = re.compile(r"^.*(?:! Findings|motor \d answered).*$", re.MULTILINE)
        texts = [other.sub("", text) for text in texts]
        assert all("§" in text and "!" not in text for text in texts)
        copy.run("report", "samples/damaged.mcap", "-o", "a.html")
        page = (copy.folder / "a.html").read_text()
        data = zlib.decompress(b64decode(page.partition('id="data">')[2].partition("<")[0]))
        assert b"#123456" in data
        assert b"#d03b3b" not in data
        assert "--malformed: #654321" in page


@pytest.mark.slow
def test_default_of_a_recording(recipe: Recipe) -> None:
    recipe.replace(
        "fte_sniff/recording/retention.py", "DEFAULT_FLUSH_S = 1.0", "DEFAULT_FLUSH_S = 7.5"
    )
    with recipe.program() as copy:
        assert all("7.5" in copy.run(name, "--help") for name in ("live", "bridge"))
        assert "7.5" in copy.page_part("commands")


@pytest.mark.slow
def test_compression_of_chunks(recipe: Recipe) -> None:
    writer = "fte_sniff/recording/mcap/writer.py"
    recipe.replace(writer, 'compression="zstd"', 'compression=""')
    recipe.replace(writer, "zstandard.ZstdCompressor(level=_LEVEL).compress(records)", "records")
    with recipe.program() as copy:
        raw = write(copy, "a.raw", FRAMES * 200)
        copy.run("decode", raw, "--start", "2026-01-31T12:00:00Z", "-o", "a.mcap")
        copy.run("live", "sim://?seed=1", "--plain", "--count", "20", "-o", "b.mcap")
        assert SPEED in (copy.folder / "a.mcap").read_bytes()
        assert len(rows_of(copy, "a.mcap")) == 600
        assert len(rows_of(copy, "b.mcap")) >= 20


@pytest.mark.slow
def test_translation(recipe: Recipe) -> None:
    original = 'msgid "one row up; leaves the end"\nmsgstr "'
    catalogue = "fte_sniff/tui/locale/zh/LC_MESSAGES/fte-sniff"
    recipe.replace(f"{catalogue}.po", original, f"{original}你好")
    recipe.make(f"{catalogue}.mo")
    with recipe.program() as copy:
        assert "not current" in copy.unfinished_texts()
        copy.python("import runpy; runpy.run_path('docs/catalogues.py', run_name='__main__')")
        assert "你好" in copy.page_part("keys zh")
