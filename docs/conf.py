"""Settings of the site: `sphinx-build -c docs -W . build/site`.

The pages are plain Markdown that a code forge shows as well, README and CHANGELOG among them. The
contents on the left are the sections and links of docs/index.md.
"""

import re

from sphinx.application import Sphinx

project = "fte-sniff"
extensions = ["myst_parser"]
html_theme = "furo"
html_title = "fte-sniff"
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**.md", "benchmarks/RESULTS.md"]
smartquotes = False
myst_heading_anchors = 4
myst_links_external_new_tab = False

_SECTION = re.compile(r"^## (?P<caption>.+)\n(?P<text>(?:(?!## ).*\n)*)", re.M)
_PAGE = re.compile(r"\]\((?P<page>[\w/.-]+)\.md\)")


def _add_contents(_app: Sphinx, page: str, source: list[str]) -> None:
    """Append a hidden table of contents for each section of the index."""
    if page == root_doc:
        for section in _SECTION.finditer(source[0]):
            pages = "\n".join(dict.fromkeys(_PAGE.findall(section["text"])))
            source[0] += (
                f"\n```{{toctree}}\n:hidden:\n:caption: {section['caption']}\n\n{pages}\n```\n"
            )


def setup(app: Sphinx) -> None:
    """Connect to Sphinx."""
    app.connect("source-read", _add_contents)
