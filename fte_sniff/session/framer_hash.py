"""Hash of the framer's sources, which the name of the compiled library contains.

`setup.py` runs this file by its path, because an installation cannot import the package it builds.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path


def framer_sources(folder: Path) -> list[Path]:
    """Modules of `folder` to compile. Not `__init__`: the library has to be inside its package."""
    return sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")


def library_name(folder: Path) -> str:
    """Module name of the library that mypyc builds from the sources in `folder`."""
    content = sha256()
    for path in framer_sources(folder):
        content.update(b"%b\0%b\0" % (path.name.encode(), path.read_bytes()))
    return f"sources_{content.hexdigest()[:12]}__mypyc"
