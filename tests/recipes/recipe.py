"""A recipe: a row of CONTRIBUTING's "Where do I put ...", applied to a copy of the project.

The copy is edited only in files that the row names; the edits are undone at the end. The program of
the copy is loaded once for all commands of a recipe.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from tests.cli.conftest import plain_environment
from tests.cli.forked import Program

ROOT: Final = Path(__file__).parents[2]
PACKAGE: Final = "fte_sniff"
HEADING: Final = "## Where do I put ..."


class TableRow(NamedTuple):
    """A row of the table."""

    new: str
    """What is added: `a column`."""
    cells: Sequence[str]
    """Where it goes, as Markdown."""

    @property
    def test(self) -> str:
        """The name of its test: `test_column`."""
        noun = re.sub(r"^(an?|the) | [(].*", "", self.new.replace("`", ""))
        return f"test_{re.sub(r'[^a-z]+', '_', noun.lower())}"

    def names(self, path: str) -> bool:
        """Whether the row names a file, by its path in the project or in the package."""
        known = (path, path.removeprefix(f"{PACKAGE}/"))
        return any(re.fullmatch(pattern, one) for pattern in self._patterns() for one in known)

    def _patterns(self) -> Iterator[str]:
        folder = ""
        for name in re.findall(r"`([\w./]+)`", " ".join(self.cells)):
            if "/" not in name and not name.endswith((".py", ".md", ".toml")):
                continue
            path = name if "/" in name else f"{folder}{name}"
            folder = f"{path.rpartition('/')[0]}/"
            yield re.escape(path).replace("NAME", r"\w+").replace("SCHEME", r"\w+") + (
                ".*" if name.endswith("/") else ""
            )
            yield re.escape(name)


def table_rows() -> list[TableRow]:
    """The rows of the table."""
    table = (ROOT / "CONTRIBUTING.md").read_text("utf-8").partition(HEADING)[2].split("\n\n")[1]
    rows = [re.split(r" ?(?<!\\)\| ?", line)[1:-1] for line in table.splitlines()]
    return [TableRow(new, cells) for new, *cells in rows[2:]]


class Copy:
    """The program of an edited copy."""

    def __init__(self, root: Path, folder: Path, program: Program) -> None:
        self._root, self._program = root, program
        self.folder = folder
        """The working folder of the commands, with the samples in `samples`."""
        self._environment = environment_of(root) | {
            "FTE_SNIFF_CONFIG": str(folder / "config.toml"),
            "XDG_STATE_HOME": str(folder / "state"),
            "XDG_CACHE_HOME": str(folder / "cache"),
            "COLUMNS": "200",
        }

    def run(self, *words: str, stdin: bytes = b"", code: int = 0) -> str:
        """The standard output of a command, which ends with this exit code."""
        ended = self._program.run(list(words), stdin, self.folder, self._environment)
        assert ended.code == code, (words, ended)
        return ended.output.decode()

    def python(self, source: str, *words: str, code: int = 0) -> str:
        """What Python code with these arguments writes to both streams."""
        ended = self._program.run(list(words), b"", self._root, self._environment, source)
        output = ended.output.decode() + ended.errors.decode()
        assert ended.code == code, output
        return output

    def complete(self, line: str) -> list[str]:
        """The completions of the last word of a command line in bash."""
        words = {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)}
        asked = self._environment | words | {"_FTE_SNIFF_COMPLETE": "bash_complete"}
        ended = self._program.run([], b"", self.folder, asked)
        assert (ended.code, ended.errors) == (0, b"")
        return [choice.partition(",")[2] for choice in ended.output.decode().splitlines()]

    def page_part(self, name: str) -> str:
        """A generated part of the documentation."""
        source = "import sys; sys.path.insert(0, 'docs'); import reference\n"
        return self.python(f"{source}print(reference.GENERATED[{name!r}]())")

    def screen(self, file: str | Path, *keys: str) -> str:
        """The screen on a file of raw bytes after these keys, and after each before."""
        source = "from tests.recipes.on_screen import show; import sys; show(*sys.argv[1:])"
        return self.python(source, str(self.folder / file), *keys)

    def unfinished_texts(self) -> str:
        """The texts of the screen that need a translation."""
        source = "import runpy; runpy.run_path('docs/catalogues.py', run_name='__main__')"
        return self.python(source, "--check", code=1)


class Recipe:
    """The edits of a row of the table in a copy of the project."""

    def __init__(self, root: Path, folder: Path, row: TableRow) -> None:
        self._root, self._folder, self._row = root, folder, row
        self._before: dict[Path, Path | None] = {}

    def replace(self, path: str, old: str, new: str) -> None:
        """Replace a text that is in a file once."""
        text = self._opened(path).read_text("utf-8")
        assert text.count(old) == 1, f"{path} has {text.count(old)} times {old!r}"
        (self._root / path).write_text(text.replace(old, new), "utf-8")

    def after(self, path: str, line: str, new: str) -> None:
        """Insert a text after a line."""
        self.replace(path, f"{line}\n", f"{line}\n{new}")

    def before(self, path: str, line: str, new: str) -> None:
        """Insert a text before a line."""
        self.replace(path, line, f"{new}{line}")

    def append(self, path: str, new: str) -> None:
        """Add a text at the end of a file, which is created if there is none."""
        opened = self._opened(path)
        text = opened.read_text("utf-8") if opened.exists() else ""
        (self._root / path).write_text(text + new, "utf-8")

    def make(self, path: str) -> None:
        """Allow the copy to make a file again."""
        self._opened(path)

    def _opened(self, path: str) -> Path:
        """A file that is to be changed, in the copy: the row must name it."""
        assert self._row.names(path), f"the row of {self._row.new} does not name {path}"
        file = self._root / path
        if file not in self._before:
            kept = self._folder / f"before{len(self._before)}"
            self._before[file] = Path(shutil.copy2(file, kept)) if file.exists() else None
        return file

    @contextmanager
    def program(self) -> Iterator[Copy]:
        """The program of the copy, with all edits so far."""
        folder = self._folder / "work"
        folder.mkdir()
        (folder / "samples").symlink_to(ROOT / "samples")
        with Program(environment_of(self._root), self._root) as program:
            yield Copy(self._root, folder, program)

    def undo(self) -> None:
        """Make the copy what it was."""
        for file, before in self._before.items():
            if before is None:
                file.unlink()
            else:
                shutil.move(before, file)


def environment_of(root: Path) -> dict[str, str]:
    """The environment in which Python finds the package and the tests of a copy."""
    return plain_environment() | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
