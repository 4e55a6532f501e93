"""Check the links between the pages as a code forge shows them: `python docs/links.py`.

Each link and picture leads to a file of the repository, and each anchor to a heading of its page.
Links to other sites are not followed. Every page of docs/ is reached from docs/index.md.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

from markdown_it import MarkdownIt
from markdown_it.token import Token

TOP = Path(__file__).parents[1]
PAGES = sorted([*TOP.glob("*.md"), *(TOP / "docs").rglob("*.md")])
"""Every page: README, CONTRIBUTING, CHANGELOG and docs/."""

_NOT_IN_ANCHOR = re.compile(r"[^\w\- ]")


def tokens(page: str) -> list[Token]:
    """The Markdown of a page."""
    return MarkdownIt("commonmark").enable("table").parse(page)


def anchors(page: str) -> set[str]:
    """The anchors that a code forge gives the headings: lower case, hyphens for spaces."""
    parsed, seen, found = tokens(page), Counter[str](), set()
    for opening, content in pairwise(parsed):
        if opening.type == "heading_open":
            text = "".join(one.content for one in content.children or ())
            anchor = _NOT_IN_ANCHOR.sub("", text.lower()).replace(" ", "-")
            found.add(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
            seen[anchor] += 1
    return found


def links(page: str) -> Iterator[str]:
    """The targets of links and pictures."""
    for block in tokens(page):
        for one in block.children or ():
            target = one.attrGet("href") or one.attrGet("src")
            if target:
                yield unquote(str(target))


def broken(path: Path, top: Path = TOP) -> Iterator[str]:
    """What is wrong with the links of a page, one line for each."""
    for link in links(path.read_text(encoding="utf-8")):
        parts = urlsplit(link)
        target = (path.parent / parts.path).resolve() if parts.path else path
        if parts.scheme:
            continue
        if not target.exists():
            yield f"{path.relative_to(top)}: {link}: no such file"
        elif parts.fragment and parts.fragment not in anchors(target.read_text(encoding="utf-8")):
            yield f"{path.relative_to(top)}: {link}: no such heading"


def unreached() -> Iterator[str]:
    """The pages of docs/ to which docs/index.md does not link."""
    index = TOP / "docs/index.md"
    listed = {(index.parent / link).resolve() for link in links(index.read_text(encoding="utf-8"))}
    for path in PAGES:
        if index.parent in path.parents and path not in {index, *listed}:
            yield f"{path.relative_to(TOP)}: docs/index.md has no link to it"


if __name__ == "__main__":
    faults = [fault for path in PAGES for fault in broken(path)] + list(unreached())
    print(*faults, sep="\n", file=sys.stderr, end="\n" if faults else "")
    sys.exit(bool(faults))
