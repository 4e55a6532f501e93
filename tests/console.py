r"""Console sessions: Markdown files with commands and the output that a user sees.

    ## A file that is missing

    ```toml rules.toml
    a file of the session's folder
    ```

    ```console
    $ fte-sniff decode nothing.raw
    2> fte-sniff: nothing.raw: no such file; check the name and the folder
    exit 4
    ```

`<!-- needs: program -->` above the first session names marks of all sessions of a file.

A session is a second-level heading: its commands run in one empty folder that has the samples, in
the process of the test. `2>` begins a line of standard error, and `exit` is an exit code other than
0. In expected lines `...` is any number of lines, and `[..]` any text within a line. Commands are
joined by `|`, `<` and `>`; `NAME=value` before a command sets a variable, and `\u001b` is a
character. Besides `fte-sniff` there
are the commands of `COMMANDS`, which behave alike on every machine. `pytest --bless` writes what is
printed at present where it differs.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import reduce
from itertools import takewhile
from pathlib import Path

from tests.in_process import Done, call

ANY_LINES, ANY_TEXT = "...", "[..]"
FENCE = "```"
NEEDS = re.compile(r"^<!-- needs: (.*) -->$", re.MULTILINE)
ESCAPE = re.compile(r"\\u([0-9a-f]{4})")
SAMPLES = Path(__file__).parents[1] / "samples"


@dataclass
class Step:
    """A command, and the lines that are expected of it."""

    command: str
    expected: list[str] = field(default_factory=list)


@dataclass
class GivenFile:
    """A file that a session begins with, or gets between two steps."""

    fence: str
    name: str
    lines: list[str]


@dataclass
class Session:
    """A heading with the text, the files and the steps below it."""

    heading: str
    needs: tuple[str, ...] = ()
    parts: list[str | GivenFile | Step] = field(default_factory=list)

    def markdown(self) -> Iterator[str]:
        """The lines of the file."""
        yield self.heading
        for part in self.parts:
            match part:
                case str():
                    yield part
                case GivenFile():
                    yield from (part.fence, *part.lines, FENCE)
                case Step():
                    yield from (f"$ {part.command}", *part.expected)


def sessions_of(path: Path) -> list[Session]:
    """The sessions of a file; the first is the text before the first second-level heading."""
    text = path.read_text("utf-8")
    needed = NEEDS.search(text)
    needs = tuple(needed[1].split()) if needed else ()
    found = [Session("")]
    lines = iter(text.splitlines())
    for line in lines:
        parts = found[-1].parts
        info = line.removeprefix(FENCE).split()
        if line.startswith("## "):
            found.append(Session(line, needs))
        elif line.startswith(FENCE) and len(info) == 2:
            parts.append(GivenFile(line, info[1], [*takewhile(lambda one: one != FENCE, lines)]))
        elif line == f"{FENCE}console":
            parts.append(line)
            parts.extend(_steps(takewhile(lambda one: one != FENCE, lines)))
            parts.append(FENCE)
        else:
            parts.append(line)
    return found


def _steps(lines: Iterator[str]) -> list[Step]:
    steps: list[Step] = []
    for line in lines:
        if line.startswith("$ "):
            steps.append(Step(line[2:]))
        else:
            steps[-1].expected.append(line)
    return steps


def play(session: Session, folder: Path, environment: Mapping[str, str], *, bless: bool) -> None:
    """Run the commands of a session in a folder, and compare what they print.

    Args:
        bless: whether to set the expected lines to what is printed, where they differ.

    Raises:
        AssertionError: Another output than expected.
    """
    copy_samples(folder)
    for part in session.parts:
        match part:
            case GivenFile():
                (folder / part.name).write_text("".join(f"{one}\n" for one in part.lines), "utf-8")
            case Step():
                found = printed(part.command, folder, environment)
                if bless and not fits(part.expected, found):
                    part.expected = found
                shown = "\n".join([f"$ {part.command}", *found])
                assert fits(part.expected, found), f"expected:\n{part.expected}\nfound:\n{shown}"


def copy_samples(folder: Path) -> None:
    """Copies of the samples: a session may overwrite them."""
    for sample in SAMPLES.iterdir():
        if sample.suffix in (".mcap", ".raw", ".hex"):
            shutil.copyfile(sample, folder / sample.name)


def replace_session(path: Path, session: Session) -> None:
    """Write a session into its file again."""
    lines: list[str] = []
    for one in sessions_of(path):
        lines += (session if one.heading == session.heading else one).markdown()
    path.write_text("\n".join(lines[1:]) + "\n", "utf-8")


def fits(expected: Sequence[str], found: Sequence[str]) -> bool:
    """Whether lines are as expected."""
    parts = (
        "(?:.*\n)*" if line == ANY_LINES else ".*".join(map(re.escape, line.split(ANY_TEXT))) + "\n"
        for line in expected
    )
    return re.fullmatch("".join(parts), "".join(f"{line}\n" for line in found)) is not None


def printed(line: str, folder: Path, environment: Mapping[str, str]) -> list[str]:
    """The lines that a command line prints; folders are written as DIR and HOME."""
    given, errors, code = b"", b"", 0
    for command in _commands(line):
        if command.source is not None:
            given = (folder / command.source).read_bytes()
        done = _run(command, given, folder, {**environment, **command.variables})
        given, errors, code = done.output, errors + done.errors, done.code
        if command.target is not None:
            (folder / command.target).write_bytes(given)
            given = b""
    lines = given.decode(errors="backslashreplace").splitlines()
    lines += [f"2> {one}" for one in errors.decode(errors="backslashreplace").splitlines()]
    known = {str(folder): "DIR", environment["HOME"]: "HOME"}
    for path, name in known.items():
        lines = [one.rstrip().replace(path, name) for one in lines]
    return [*lines, f"exit {code}"] if code else lines


@dataclass
class Command:
    """One program of a command line."""

    variables: dict[str, str] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    source: str | None = None
    target: str | None = None


def _commands(line: str) -> list[Command]:
    """The programs of a command line, joined by `|`."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="<>|")
    lexer.whitespace_split = True
    found = [Command()]
    for word in lexer:
        name, equals, value = word.partition("=")
        match word:
            case "|":
                found.append(Command())
            case "<":
                found[-1].source = next(lexer)
            case ">":
                found[-1].target = next(lexer)
            case _ if equals and name.isupper() and not found[-1].words:
                found[-1].variables[name] = value
            case _:
                found[-1].words.append(ESCAPE.sub(lambda at: chr(int(at[1], 16)), word))
    return found


def _run(command: Command, given: bytes, folder: Path, environment: Mapping[str, str]) -> Done:
    name, *words = command.words
    if name == "fte-sniff":
        places = [word.replace("DIR", str(folder)) for word in words]
        return call(places, given, folder, environment)
    output = COMMANDS[name](words, given, folder)
    return Done(0, output, b"") if output is not None else Done(1, b"", b"")


def _grep(words: list[str], given: bytes, folder: Path) -> bytes | None:
    """`grep [-c] PATTERN`: the lines in which a regular expression is, or their number."""
    lines = [one for one in given.splitlines(keepends=True) if re.search(words[-1].encode(), one)]
    if words[0] == "-c":
        return b"%d\n" % len(lines)
    return b"".join(lines) or None


def _head(words: list[str], given: bytes, folder: Path) -> bytes:
    """`head -n LINES` of standard input, `head -c BYTES FILE`; negative: all but the last."""
    option, count, *names = words
    if option == "-n":
        return b"".join(given.splitlines(keepends=True)[: int(count)])
    return (folder / names[0]).read_bytes()[: int(count)]


def _tail(words: list[str], given: bytes, folder: Path) -> bytes:
    """`tail -n LINES`: the last lines."""
    return b"".join(given.splitlines(keepends=True)[-int(words[1]) :])


def _count(words: list[str], given: bytes, folder: Path) -> bytes:
    """`lines`: the number of lines."""
    return b"%d\n" % len(given.splitlines())


def _cat(words: list[str], given: bytes, folder: Path) -> bytes:
    """`cat FILE...`: their bytes."""
    return b"".join((folder / name).read_bytes() for name in words)


def _copy(words: list[str], given: bytes, folder: Path) -> bytes:
    """`cp FILE... TARGET`."""
    *names, target = words
    for name in names:
        shutil.copyfile(
            folder / name,
            folder / target / name if (folder / target).is_dir() else folder / target,
        )
    return b""


def _compare(words: list[str], given: bytes, folder: Path) -> bytes | None:
    """`cmp FILE [FILE]`: fails if a file differs from the second, or from standard input."""
    one, other = (
        ((folder / name).read_bytes() for name in words)
        if len(words) == 2
        else (
            given,
            (folder / words[0]).read_bytes(),
        )
    )
    return b"" if one == other else None


def _flip(words: list[str], given: bytes, folder: Path) -> bytes:
    """`flip FILE OFFSET`: its bytes with one of them inverted."""
    data = bytearray((folder / words[0]).read_bytes())
    data[int(words[1])] ^= 0xFF
    return bytes(data)


def _list(words: list[str], given: bytes, folder: Path) -> bytes | None:
    """`ls PATTERN`: the names of files, sorted; fails if there is none."""
    names = sorted(str(one.relative_to(folder)) for one in folder.glob(words[0]))
    return "".join(f"{name}\n" for name in names).encode() or None


def _encode(words: list[str], given: bytes, folder: Path) -> bytes:
    """`encode ENCODING FILE`: a text file in another encoding."""
    return (folder / words[1]).read_bytes().decode().encode(words[0])


def _make_folders(words: list[str], given: bytes, folder: Path) -> bytes:
    """`mkdir NAME...`."""
    for name in words:
        (folder / name).mkdir()
    return b""


def _touch(words: list[str], given: bytes, folder: Path) -> bytes:
    """`touch FILE...`: empty files; `touch -d TIME FILE` sets the time of modification."""
    if words[0] != "-d":
        for name in words:
            (folder / name).touch()
        return b""
    time_s = datetime.fromisoformat(words[1]).timestamp()
    os.utime(folder / words[2], (time_s, time_s))
    return b""


def _drop(words: list[str], given: bytes, folder: Path) -> bytes:
    """`drop BYTES FILE`: all but the first bytes."""
    return (folder / words[1]).read_bytes()[int(words[0]) :]


def _link(words: list[str], given: bytes, folder: Path) -> bytes:
    """`ln -s TARGET LINK`."""
    (folder / words[2]).symlink_to(words[1])
    return b""


def _echo(words: list[str], given: bytes, folder: Path) -> bytes:
    """`echo TEXT...`."""
    return (" ".join(words) + "\n").encode()


def _bytes(words: list[str], given: bytes, folder: Path) -> bytes:
    """`bytes HEX...`: these bytes; `50*00` repeats."""
    found = b""
    for word in words:
        count, _, text = word.rpartition("*")
        found += bytes.fromhex(text) * int(count or 1)
    return found


def _json(words: list[str], given: bytes, folder: Path) -> bytes:
    """`json PATH...`: members of each line's object, or of one object of several lines."""
    try:
        values = [json.loads(given)]
    except json.JSONDecodeError:
        values = [json.loads(line) for line in given.splitlines()]
    texts = (
        " ".join(json.dumps(reduce(_member, path.split("."), value)) for path in words)
        for value in values
    )
    return "".join(f"{text}\n" for text in texts).encode()


def _member(value: object, key: str) -> object:
    """A member of a JSON value, or of each of a list."""
    if isinstance(value, list):
        return (
            value[int(key)] if key.lstrip("-").isdigit() else [_member(one, key) for one in value]
        )
    assert isinstance(value, dict)
    return value[key]


COMMANDS: Mapping[str, Callable[[list[str], bytes, Path], bytes | None]] = {
    "bytes": _bytes,
    "cat": _cat,
    "cmp": _compare,
    "cp": _copy,
    "drop": _drop,
    "echo": _echo,
    "encode": _encode,
    "flip": _flip,
    "grep": _grep,
    "head": _head,
    "json": _json,
    "lines": _count,
    "ln": _link,
    "ls": _list,
    "mkdir": _make_folders,
    "tail": _tail,
    "touch": _touch,
}
