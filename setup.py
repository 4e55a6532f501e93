"""Owns how the framer is compiled when fte-sniff is installed: by mypyc, from its Python source.

It must not know what stands in the framer, nor anything else of the package: `pyproject.toml` does.

The source is the only implementation. What was compiled lies beside it, where it is found first,
and stands on one library, `sources_HASH__mypyc`, whose name says of which sources it was made.
Where there is no C compiler, no Python.h or no mypy, nothing is compiled, and the source itself is
run. With FTE_SNIFF_COMPILED=0 nothing is compiled anyway; with 1 it is an error where that fails.
"""

from __future__ import annotations

import os
import sys
from hashlib import sha256
from pathlib import Path
from sysconfig import get_config_var
from textwrap import shorten
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from setuptools import Extension

ROOT = Path(__file__).parent
FRAMER = Path("fte_sniff/protocol/framer")
CHOICE = "FTE_SNIFF_COMPILED"
NOTHING_BUILT = {"egg_info", "dist_info", "sdist", "clean"}
"""Commands that need no extension."""
FLAGS = ("-Wno-error", "-fvisibility=hidden", "-fno-semantic-interposition")
"""For the C compiler: warnings are none of the user's business; and since no other library calls
the functions, one may be put into another."""
IN_PLACE = {"editable_wheel", "develop", "--inplace", "-i"}


def sources() -> list[Path]:
    """What is compiled. `__init__` is not: the library could not lie within its package then."""
    return sorted(path for path in (ROOT / FRAMER).glob("*.py") if path.name != "__init__.py")


def library() -> str:
    """The full name of the module that holds what is compiled of the present sources."""
    told = sha256()
    for path in sources():
        told.update(b"%b\0%b\0" % (path.name.encode(), path.read_bytes()))
    return f"{'.'.join(FRAMER.parts)}.sources_{told.hexdigest()[:12]}__mypyc"


def forget(folder: Path) -> None:
    """Remove what this Python would load of an earlier build."""
    for path in folder.glob(f"*{get_config_var('EXT_SUFFIX')}"):
        path.unlink()


def interpreted(reason: object) -> None:
    """Say that nothing is compiled.

    Raises:
        SystemExit: it has to be.
    """
    why = shorten(str(reason), 150, placeholder=" ...")
    if os.environ.get(CHOICE) == "1":
        raise SystemExit(f"fte-sniff: the framer cannot be compiled: {why}")
    line = f"fte-sniff: the framer is not compiled, and will be interpreted, which is slower: {why}"
    print(line, file=sys.stderr)


def extensions() -> list[Extension]:
    """One for the library, and one for each module; none if they cannot be translated to C."""
    if os.environ.get(CHOICE) == "0":
        return []
    try:
        from mypyc.build import mypycify

        made: list[Extension] = mypycify(
            ["--config-file=setup.cfg", *(str(path.relative_to(ROOT)) for path in sources())],
            opt_level="3",
            debug_level="0",
            group_name=library().removesuffix("__mypyc"),
        )
    except ImportError as error:
        interpreted(f"{error}; it takes mypy[mypyc]")
        return []
    except SystemExit:
        interpreted("mypy refuses it")  # and has said why
        return []
    for extension in made if os.name == "posix" else ():
        extension.extra_compile_args = [*extension.extra_compile_args, *FLAGS]
    return made


def build() -> None:
    """Hand all that to setuptools."""
    from setuptools import setup
    from setuptools.command.build_ext import build_ext
    from setuptools.errors import BaseError, CCompilerError

    class AllOrNothing(build_ext):
        """Modules without their library could not be loaded, so one failure takes all."""

        def build_extensions(self) -> None:
            try:
                super().build_extensions()
            except (BaseError, CCompilerError) as error:
                interpreted(f"it takes a C compiler and the headers of Python; {error}")
                forget(Path(self.build_lib, FRAMER))
                self.extensions = []

    commands = set(sys.argv[1:])
    if commands & NOTHING_BUILT:
        setup()
        return
    os.chdir(ROOT)
    for folder in ROOT.glob(f"build/lib*/{FRAMER}"):
        forget(folder)
    if commands & IN_PLACE:
        forget(ROOT / FRAMER)
    setup(ext_modules=extensions(), cmdclass={"build_ext": AllOrNothing})


if __name__ == "__main__":
    build()
