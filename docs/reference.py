"""The generated parts of the pages: commands, rows, frames, keys and the Python API, as Markdown.

A part of a page between `<!-- generated: NAME -->` and `<!-- end -->` is replaced by the text of
`GENERATED[NAME]`. `docs/console.py` does it.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path

import click
import griffe
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorSet,
)
from mcap.reader import make_reader

import fte_sniff
from fte_sniff.analysis.filter.row_filter import EXAMPLES, FUNCTIONS
from fte_sniff.cli.main import COMMANDS, PROGRAM
from fte_sniff.cli.options import NUMBER
from fte_sniff.errors import ExplainedWord
from fte_sniff.i18n import _, set_language
from fte_sniff.protocol.columns import COLUMNS
from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    HEADERS,
    KINDS,
    TAIL,
    Direction,
    Fault,
    Field,
    FrameKind,
    status_of,
)
from fte_sniff.tui.commands import SECTIONS, Command, key_name

_PART = re.compile(r"(?<=^<!-- generated: )([\w ]+)( -->\n).*?(?=^<!-- end -->$)", re.M | re.S)

SAMPLE = Path(__file__).parents[1] / "samples/clean.mcap"
"""A recording: every topic and schema is in every recording."""

NO_CELL = "–"
LONGEST_VALUE = 60
"""Characters of a constant whose value is shown."""


def refreshed(page: str) -> str:
    """The page with its generated parts made again.

    Raises:
        KeyError: a part has an unknown name.
    """
    return _PART.sub(lambda part: f"{part[1]}{part[2]}{GENERATED[part[1]]()}\n", page)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(map(_cell, line))} |\n" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _code(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def in_chinese(part: Callable[..., str], *heads: object) -> str:
    """A part with the texts of the Chinese screen."""
    set_language("zh")
    try:
        return part(*heads)
    finally:
        set_language("en")


# The frame table


def rows_table() -> str:
    """The columns of a row."""
    described = (
        (column.meaning + (f": {_code(column.words)}" if column.words else ""), column)
        for column in COLUMNS
    )
    return table(
        ("name", "type", "meaning"),
        ((f"`{column.name}`", column.type.value, text) for text, column in described),
    )


def functions_table(function: str = "example", meaning: str = "meaning") -> str:
    """The functions of filters, with these headings."""
    own = [(text, of) for text, of in EXAMPLES if text.partition("(")[0] in FUNCTIONS]
    return table((function, meaning), ((f"`{text}`", _(of)) for text, of in own))


def faults_table() -> str:
    """The faults, with the status that each of them gives a row."""
    return table(
        ("fault", "status", "meaning"),
        ((f"`{fault}`", f"`{status_of((fault,))}`", fault.meaning) for fault in Fault),
    )


def kinds_table(kind: str = "kind", meaning: str = "meaning") -> str:
    """The kinds of frames, byte by byte, with these headings."""
    return table(
        (kind, meaning, *map(str, range(FRAME_LENGTH))),
        ((f"`{each.name}`", _(each.meaning), *_layout(each)) for each in KINDS),
    )


def _layout(kind: FrameKind) -> Iterator[str]:
    by_offset = {offset: field.option for field in kind.fields for offset in field.offsets}
    fixed = {0: f"{kind.header:02X}", FRAME_LENGTH - 1: f"{TAIL:02X}"}
    fixed[1] = "/".join(f"{cmd:02X}" for cmd in kind.cmds)
    fixed |= dict.fromkeys(kind.reserved, _reserve(kind))
    for offset in range(FRAME_LENGTH):
        yield fixed.get(offset) or by_offset.get(offset, NO_CELL)


def _reserve(kind: FrameKind) -> str:
    return "reserve" if kind.reserve is None else f"{kind.reserve:02X}"


def fields_table(
    heads: Sequence[str] = ("kind", "bytes", "column", "meaning", "range"),
) -> str:
    """The fields of each kind, with these headings."""
    return table(
        heads,
        (
            (f"`{kind.name}`", _bytes(field), f"`{field.name}`", _(field.meaning), _range(field))
            for kind in KINDS
            for field in kind.fields
        ),
    )


def _bytes(field: Field) -> str:
    offsets = field.offsets
    return f"{offsets[0]}" if field.size == 1 else f"{offsets[0]}–{offsets[-1]}"


def _range(field: Field) -> str:
    if field.legal_bits is None:
        return field.range_text
    return f"{field.text(0)}..{field.text(field.legal_bits)}"


def headers_table(direction: str = "direction", header: str = "header") -> str:
    """Header bytes by direction, with these headings."""
    named = ((f"`{way}`", f"{HEADERS[way]:02X}") for way in Direction)
    return table((direction, header), named)


# The recording


def topics_table() -> str:
    """The topics of a recording."""
    with SAMPLE.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return table(
        ("topic", "message"),
        (
            (f"`{channel.topic}`", f"`{summary.schemas[channel.schema_id].name}`")
            for channel in summary.channels.values()
        ),
    )


def messages_table() -> str:
    """The fields of each message, with their protobuf types; first those that all rows have."""
    with SAMPLE.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    messages = {
        message.name: _fields(message)
        for schema in summary.schemas.values()
        for message in [FileDescriptorSet.FromString(schema.data).file[0].message_type[0]]
    }
    rows = [fields for name, fields in messages.items() if name != "PortEvent"]
    common = [field for field in rows[0] if all(field in fields for fields in rows)]
    own = {
        f"`fte.{name}`": [f for f in fields if name == "PortEvent" or f not in common]
        for name, fields in messages.items()
    }
    lines = {"all rows": common, **own}
    return table(("message", "fields"), ((name, ", ".join(f)) for name, f in lines.items()))


def _fields(message: DescriptorProto) -> list[str]:
    return [f"`{field.name}` {_type(field)}" for field in message.field]


def _type(field: FieldDescriptorProto) -> str:
    if field.type_name:
        return field.type_name.rpartition(".")[2]
    return FieldDescriptorProto.Type.Name(field.type).removeprefix("TYPE_").lower()


# The command line


def commands() -> str:
    """Every command with its usage, help and options."""
    root = click.Context(click.Group(PROGRAM), info_name=PROGRAM)
    parts = []
    for name in COMMANDS:
        command = importlib.import_module(f"fte_sniff.cli.{name}").command
        parts.append(_command(command, click.Context(command, root, name, max_content_width=100)))
        if isinstance(command, click.Group):
            context = click.Context(command, root, name)
            for sub in command.list_commands(context):
                found = command.get_command(context, sub)
                assert found is not None
                parts.append(_command(found, click.Context(found, context, sub), "###"))
    return "\n".join(parts)


def _command(command: click.Command, context: click.Context, level: str = "##") -> str:
    title = context.command_path.removeprefix(f"{PROGRAM} ")
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    text = "\n\n".join(map(_paragraph, (command.help or "").split("\n\n")))
    records = [
        record
        for parameter in command.params
        if isinstance(parameter, click.Option) and (record := parameter.get_help_record(context))
    ]
    options = table(
        ("option", "meaning"), ((f"`{NUMBER.sub('N', flags)}`", text) for flags, text in records)
    )
    shown = f"{level} {title}\n\n```text\n{usage}\n```\n\n{text}\n"
    return f"{shown}\n{options}" if records else shown


def _paragraph(text: str) -> str:
    """A paragraph of a help text; one that begins with \\b is an example, left as it is."""
    lines = [line.strip() for line in text.strip().splitlines()]
    if lines[0] == "\b":
        return "\n".join(["```sh", *lines[1:], "```"])
    return " ".join(lines).replace("<", "\\<")


# The keys of the screen


def keys(key: str = "key", meaning: str = "what it does") -> str:
    """The keys of the screen, by the sections of its help."""
    return "\n".join(
        f"**{_(heading)}**\n\n" + table((key, meaning), _keys_by_meaning(commands))
        for heading, commands in SECTIONS
    )


def _keys_by_meaning(commands: Iterable[Command]) -> Iterator[tuple[str, str]]:
    for meaning, same in groupby(commands, key=lambda one: _(one.meaning)):
        yield _code(key_name(key) for one in same for key in one.keys.split(",")), meaning


# The Python API


def python_api() -> str:
    """The public names, from their docstrings."""
    package = griffe.load(
        "fte_sniff", search_paths=[Path(fte_sniff.__file__).parents[1]], allow_inspection=False
    )
    by_kind = groupby(
        sorted(fte_sniff.__all__, key=lambda name: _rank(package[name])),
        key=lambda name: _rank(package[name])[0],
    )
    return "\n".join(
        f"## {_HEADINGS[rank]}\n\n" + "\n".join(_public(package[name]) for name in names)
        for rank, names in by_kind
    )


_HEADINGS = ("Functions", "Classes", "Constants and types", "Exceptions and warnings")


def _rank(item: griffe.Object | griffe.Alias) -> tuple[int, str]:
    if item.name.endswith(("Error", "Warning")):
        return 3, ""
    return (0 if item.is_function else 1 if item.is_class else 2), ""


def _public(item: griffe.Object | griffe.Alias) -> str:
    text = f"### {item.name}\n\n"
    if item.is_function:
        text += f"```python\n{_signature(item)}\n```\n\n"
    if item.is_attribute and len(str(item.value)) < LONGEST_VALUE:
        text += f"```python\n{item.name} = {item.value}\n```\n\n"
    text += _docstring(item)
    if item.is_class and _rank(item)[0] == 1:
        text += _members(item)
    return text


def _signature(item: griffe.Object | griffe.Alias, prefix: str = "") -> str:
    shown = [_parameter(one) for one in item.parameters if one.name != "self"]
    result = f" -> {item.returns}" if item.returns else ""
    return f"{prefix}{item.name}({', '.join(shown)}){result}"


def _parameter(one: griffe.Parameter) -> str:
    default = f" = {one.default}" if one.default is not None else ""
    return f"{one.name}: {one.annotation}{default}"


def _described(
    item: griffe.Object | griffe.Alias, one: griffe.Object | griffe.Alias
) -> tuple[str, str]:
    """The type or value of an attribute, and its meaning; some words have their own."""
    word = getattr(getattr(fte_sniff, item.name), one.name, None)
    if isinstance(word, ExplainedWord):
        return f"`{word.value!r}`", word.meaning
    return f"`{one.annotation or one.value}`", _first(one)


def _members(item: griffe.Object | griffe.Alias) -> str:
    public = [one for one in item.members.values() if not one.name.startswith("_")]
    values = [(f"`{one.name}`", *_described(item, one)) for one in public if one.is_attribute]
    methods = [one for one in public if one.is_function]
    text = "\n" + table(("attribute", "type or value", "meaning"), values) if values else ""
    for one in methods:
        text += f"\n```python\n{_signature(one)}\n```\n\n{_docstring(one)}"
    return text


def _first(item: griffe.Object | griffe.Alias) -> str:
    return item.docstring.value if item.docstring else ""


def _docstring(item: griffe.Object | griffe.Alias) -> str:
    if item.docstring is None:
        return ""
    parts = []
    for section in item.docstring.parse("google", warnings=False):
        if section.kind is griffe.DocstringSectionKind.text:
            parts.append(f"{section.value}\n")
        elif section.kind is griffe.DocstringSectionKind.examples:
            parts.append(
                "```python\n" + "\n".join(text for _kind, text in section.value) + "\n```\n"
            )
        else:
            parts.append(
                f"**{section.kind.value.capitalize()}**\n\n" + "".join(map(_item, section.value))
            )
    return "\n".join(parts)


def _item(entry: griffe.DocstringElement) -> str:
    name = getattr(entry, "name", "") or entry.annotation
    return f"- `{name}`: {' '.join(entry.description.split())}\n"


GENERATED: Mapping[str, Callable[[], str]] = {
    "rows": rows_table,
    "faults": faults_table,
    "kinds": kinds_table,
    "fields": fields_table,
    "headers": headers_table,
    "topics": topics_table,
    "messages": messages_table,
    "commands": commands,
    "keys": keys,
    "headers zh": lambda: in_chinese(headers_table, "方向", "帧头"),
    "kinds zh": lambda: in_chinese(kinds_table, "帧类型", "含义"),
    "fields zh": lambda: in_chinese(fields_table, ("帧类型", "字节", "列", "含义", "范围")),
    "keys zh": lambda: in_chinese(keys, "按键", "作用"),
    "functions": functions_table,
    "functions zh": lambda: in_chinese(functions_table, "例子", "含义"),
    "python api": python_api,
}
"""Makers of the generated parts, by name."""
