"""Update the catalogues of the screen's languages: `python docs/catalogues.py [--check]`.

Texts are found in calls, `_("...")`, `later("...")`, `TranslatableText("...")` and `FileError("...
{path}", path=...)`, and in the tables that the screen shows: keys, meanings of fields, faults and
columns, examples of filters. New texts are added to each `.po` file, where they are translated by
hand; the program reads the `.mo` file. `--check` changes nothing, and fails where a text is not
translated, a translation has other values in braces, or a file is not current.
"""

import argparse
import ast
import io
import re
import string
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from babel.messages.catalog import Catalog
from babel.messages.mofile import read_mo, write_mo
from babel.messages.pofile import read_po, write_po

from fte_sniff import errors
from fte_sniff.analysis.check import MEASURES, RuleResult
from fte_sniff.analysis.filter.row_filter import EXAMPLES
from fte_sniff.analysis.findings import Cause
from fte_sniff.analysis.motors import Trouble
from fte_sniff.cli.check import NUMBER
from fte_sniff.errors import REASONS, UNREADABLE, UNWRITABLE, Joint
from fte_sniff.i18n import CATALOGUES, DOMAIN, LANGUAGES
from fte_sniff.protocol.columns import COLUMNS
from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.spec import KINDS, Fault, Role, Status
from fte_sniff.recording.output_file import STOPPED
from fte_sniff.tui.cells import TimeStyle, event_words
from fte_sniff.tui.commands import COMMANDS, SECTIONS
from fte_sniff.tui.painter import Sign
from fte_sniff.tui.status import Mode

# The checkout, since the installed package has no `.po` files.
PACKAGE = Path(__file__).parents[1] / "fte_sniff"

KEYWORDS = ("_", "later", "TranslatableText", "RecordError")
"""Functions that are called with a text to translate."""

FINISHED = ("print_err", "BadParameter", "fail", "_mistake", "ok", "warn", "bad", "note")
"""Functions, beside errors, that are called with a text, or an f-string, to recognise."""


CLICK = (
    "Invalid value for {name}: {what}",
    "Invalid value: {what}",
    "Missing argument {name}",
    "Missing option {name}",
    "No such command {name}",
    "No such command {name}. Did you mean {near}?",
    "No such command {name}. (Did you mean one of: {near}?)",
    "No such option {name}",
    "No such option {name}. Did you mean {near}?",
    "No such option {name}. (Did you mean one of: {near}?)",
    "Option {name} requires an argument",
    "Got unexpected extra argument ({what})",
    "Got unexpected extra arguments ({what})",
    "{value} is not in the range {range}",
    "{value} is not one of {choices}",
    "{value} is not a whole number",
    "see '{path} --help'",
    "; ",
    ", ",
)
"""Errors of click, and what `translated` finds between the parts of a text."""


def table_texts() -> Iterator[str]:
    """Texts of the tables that the screen shows, and those of libraries."""
    yield from CLICK
    yield from (heading for heading, _commands in SECTIONS)
    for command in COMMANDS.values():
        yield from (command.meaning, command.short)
    for kind in KINDS:
        yield kind.meaning
        for field in kind.fields:
            yield from (field.meaning, field.erratum)
    yield from (fault.meaning for fault in Fault)
    yield from (column.meaning for column in COLUMNS)
    yield from (meaning for _, meaning in EXAMPLES)
    yield from Mode
    yield from Status
    yield from (*REASONS.values(), *UNREADABLE.values(), *UNWRITABLE.values())
    yield from STOPPED.values()
    yield from Joint
    yield from (measure.needs for measure in MEASURES.values())
    units = {measure.unit for measure in MEASURES.values()} | {column.unit for column in COLUMNS}
    yield from (f"{{value:{NUMBER}}} {unit}" for unit in units if unit.isalpha() and len(unit) > 3)
    yield from RuleResult
    yield from (Role.SPEED, Role.POSITION)
    yield from (event_words(kind) for kind in PortEventKind)
    yield from (one.value for one in Trouble)
    yield from map(str, Cause)
    for style in TimeStyle:
        yield from (style, style.meaning)
    yield from (sign.meaning for sign in Sign)


def texts_in(folder: Path) -> Iterator[str]:
    """Texts in calls, also inside f-strings."""
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Name(id=name),
                    args=[ast.Constant(value=str(text)), *_],
                    keywords=values,
                ):
                    # Other errors without values are not for the user.
                    is_error = name.endswith("Error") and (values or hasattr(errors, name))
                    if name in KEYWORDS or is_error:
                        yield text
                case ast.Call(func=func, args=[ast.JoinedStr(values=parts), *_]):
                    called = ast.unparse(func)
                    if hasattr(errors, called) or called.rpartition(".")[2] in FINISHED:
                        yield from filter(has_words, [form_of(parts)])


def form_of(parts: Iterable[ast.expr]) -> str:
    """The form of an f-string, with a name for each value; `translated` recognises its texts."""
    sources, form = list[str](), ""
    for part in parts:
        if isinstance(part, ast.FormattedValue):
            source = ast.unparse(part.value) + "!" * (part.conversion > 0)
            sources += [source] * (source not in sources)
            name = source if source.isidentifier() else f"value{sources.index(source)}"
            form += f"{{{name.lower()}}}"
        elif isinstance(part, ast.Constant):
            form += str(part.value)
    return form


def has_words(form: str) -> bool:
    """Whether a form has something to translate: two words beside its values and our name."""
    return len(re.findall(r"[a-z]{2,}", re.sub(r"\{.*?\}|fte-sniff:?", "", form))) > 1


def template() -> Catalog:
    """A catalogue of all texts."""
    found = Catalog(project=DOMAIN, fuzzy=False)
    for text in texts_in(PACKAGE):
        found.add(text)
    for text in table_texts():
        if text:
            found.add(str(text))
    return found


def updated(language: str, texts: Catalog) -> Catalog:
    """The catalogue of a language with exactly these texts."""
    path = _path(language, "po")
    if path.exists():
        with path.open("rb") as file:
            catalogue = read_po(file, locale=language, domain=DOMAIN)
    else:
        catalogue = Catalog(locale=language, domain=DOMAIN)
    nodes = [
        node
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
    ]
    written = {node.value for node in nodes if isinstance(node, ast.Constant)}
    written |= {form_of(node.values) for node in nodes if isinstance(node, ast.JoinedStr)}
    for message in catalogue:
        # A text that reaches its call through a variable stays once it is translated.
        if message.string and message.id in written:
            texts.add(message.id)
    catalogue.update(texts, no_fuzzy_matching=True, update_creation_date=False)
    catalogue.obsolete.clear()
    return catalogue


def faults_of(catalogue: Catalog) -> Iterator[str]:
    """Faults of the translations."""
    for message in catalogue:
        if message.id and not message.string:
            yield f"not translated: {message.id!r}"
        elif message.id and _values(message.id) != _values(message.string):
            yield f"other values in braces: {message.id!r} and {message.string!r}"


def _values(text: object) -> list[str]:
    return sorted(name for _, name, _, _ in string.Formatter().parse(str(text)) if name is not None)


def _written(catalogue: Catalog) -> bytes:
    # Without the header, which has the time and the version.
    po = io.BytesIO()
    write_po(po, catalogue, width=100, omit_header=True, sort_output=True, no_location=True)
    return po.getvalue()


def _compiled(path: Path) -> dict[str, str]:
    """Translations of a compiled catalogue."""
    if not path.exists():
        return {}
    with path.open("rb") as file:
        return {str(message.id): str(message.string) for message in read_mo(file) if message.id}


def _translations(catalogue: Catalog) -> dict[str, str]:
    return {str(each.id): str(each.string) for each in catalogue if each.id and each.string}


def _path(language: str, ending: str) -> Path:
    return PACKAGE / CATALOGUES.name / language / "LC_MESSAGES" / f"{DOMAIN}.{ending}"


def main() -> None:
    """Write the catalogues, or check them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="change nothing, fail where needed")
    check = parser.parse_args().check
    wrong = []
    for language in LANGUAGES:
        if language == "en":
            continue
        catalogue = updated(language, template())
        wrong += [f"{language}: {fault}" for fault in faults_of(catalogue)]
        po, mo = _path(language, "po"), _path(language, "mo")
        written = _written(catalogue)
        if po.exists() and po.read_bytes() == written and _compiled(mo) == _translations(catalogue):
            continue
        if check:
            wrong.append(f"{language}: not current; run python docs/catalogues.py")
            continue
        po.parent.mkdir(parents=True, exist_ok=True)
        po.write_bytes(written)
        with mo.open("wb") as file:
            write_mo(file, catalogue)
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
