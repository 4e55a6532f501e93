"""Compile the framer with mypyc at installation; all other settings are in pyproject.toml.

The Python source is the only implementation. The compiled modules are next to it, where Python
finds them first; they load one library, `sources_HASH__mypyc`, named after the hash of the sources.
Without a C compiler, Python.h or mypy, nothing is compiled and the source is interpreted.
FTE_SNIFF_COMPILED=0 skips the compilation; with 1 a failed compilation is an error.
"""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path
from sysconfig import get_config_var, get_path
from tempfile import TemporaryDirectory
from textwrap import shorten

from setuptools import Extension, setup
from setuptools.errors import BaseError, CCompilerError

ROOT = Path(__file__).parent
FRAMER = Path("fte_sniff/protocol/framer")
HASH = runpy.run_path(str(ROOT / "fte_sniff/session/framer_hash.py"))
CHOICE = "FTE_SNIFF_COMPILED"
NOTHING_BUILT = {"egg_info", "dist_info", "sdist", "clean"}
"""Commands that need no extension."""
FLAGS = ("-Wno-error", "-fvisibility=hidden", "-fno-semantic-interposition")
"""Flags of the C compiler: warnings are no errors; functions are private, so it may inline them."""
NEEDED = "it takes a C compiler and the headers of Python"
IN_PLACE = {"editable_wheel", "develop", "--inplace", "-i"}


def forget(folder: Path) -> None:
    """Remove the compiled modules of an earlier build."""
    for path in folder.glob(f"*{get_config_var('EXT_SUFFIX')}"):
        path.unlink()


def interpreted(reason: object) -> None:
    """Report that nothing is compiled.

    Raises:
        SystemExit: FTE_SNIFF_COMPILED=1 demands it.
    """
    why = shorten(str(reason), 150, placeholder=" ...")
    if os.environ.get(CHOICE) == "1":
        raise SystemExit(f"fte-sniff: the framer cannot be compiled: {why}")
    line = f"fte-sniff: the framer is not compiled, and will be interpreted, which is slower: {why}"
    print(line, file=sys.stderr)


def check_compiler() -> None:
    """Compile nothing but Python.h: without a C compiler the framer need not be translated to C.

    Raises:
        BaseError, CCompilerError: it cannot be compiled.
    """
    # Those of setuptools: Python's own are gone since 3.12.
    from distutils.ccompiler import new_compiler
    from distutils.sysconfig import customize_compiler

    with TemporaryDirectory() as folder:
        source = Path(folder, "headers.c")
        source.write_text("#include <Python.h>\n")
        compiler = new_compiler()
        customize_compiler(compiler)
        compiler.compile([str(source)], folder, include_dirs=[get_path("include")])


def extensions() -> list[Extension]:
    """Extensions of the library and each module; empty if mypyc cannot translate them."""
    if os.environ.get(CHOICE) == "0":
        return []
    try:
        from mypyc.build import mypycify

        check_compiler()
        sources = HASH["framer_sources"](ROOT / FRAMER)
        library = HASH["library_name"](ROOT / FRAMER)
        made: list[Extension] = mypycify(
            ["--config-file=setup.cfg", *(str(path.relative_to(ROOT)) for path in sources)],
            opt_level="3",
            debug_level="0",
            group_name=f"{'.'.join(FRAMER.parts)}.{library}".removesuffix("__mypyc"),
        )
    except ImportError as error:
        interpreted(f"{error}; it takes mypy[mypyc]")
        return []
    except (BaseError, CCompilerError) as error:
        interpreted(f"{NEEDED}; {error}")
        return []
    except SystemExit:
        interpreted("mypy refuses it")  # and has said why
        return []
    for extension in made if os.name == "posix" else ():
        extension.extra_compile_args = [*extension.extra_compile_args, *FLAGS]
    return made


def build() -> None:
    """Run setuptools."""
    from setuptools.command.build_ext import build_ext

    class AllOrNothing(build_ext):
        """Drops all extensions if one fails: modules cannot be loaded without their library."""

        def build_extensions(self) -> None:
            try:
                super().build_extensions()
            except (BaseError, CCompilerError) as error:
                interpreted(f"{NEEDED}; {error}")
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
