"""Keep the command outputs and the generated tables in README and docs current.

    python docs/console.py            run every command in a `console` block, insert its output
    python docs/console.py --check    report pages that are not current; exit 1 if any

A command is a line that begins with `$ `. It runs in the top folder, without a terminal, in the
language of the page. Its output on both streams follows until the next command or the end of the
block. Output that differs from run to run belongs into a `text` block. `docs/reference.py` makes
the generated tables.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import reference
from links import PAGES, TOP

BLOCK = re.compile(r"(?<=^```console\n).*?(?=^```$)", re.MULTILINE | re.DOTALL)


@cache
def output_of(command: str, locale: str) -> str:
    """The output of a command in a locale, without trailing spaces."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=TOP,
        env=os.environ | {"PATH": path, "COLUMNS": "80", "LC_ALL": "", "LANG": locale},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=120,
        check=False,
    )
    return "".join(f"{line.rstrip()}\n" for line in done.stdout.decode().splitlines())


def refreshed(page: str, locale: str = "C.UTF-8") -> str:
    """The page with current outputs and tables."""

    def run(block: re.Match[str]) -> str:
        commands = [line for line in block.group().splitlines() if line.startswith("$ ")]
        return "".join(f"{command}\n{output_of(command[2:], locale)}" for command in commands)

    return BLOCK.sub(run, reference.refreshed(page))


def main() -> int:
    """Refresh or check the pages; returns the exit code."""
    if sys.argv[1:] not in ([], ["--check"]):
        print(__doc__, file=sys.stderr)
        return 2
    stale = 0
    for path in PAGES:
        page = path.read_text(encoding="utf-8")
        is_chinese = "zh" in path.parts or "zh-CN" in path.name
        fresh = refreshed(page, "zh_CN.UTF-8" if is_chinese else "C.UTF-8")
        if sys.argv[1:] != ["--check"]:
            path.write_text(fresh, encoding="utf-8")
        elif fresh != page:
            print(
                f"not current: {path.relative_to(TOP)}; run python docs/console.py", file=sys.stderr
            )
            stale = 1
    return stale


if __name__ == "__main__":
    sys.exit(main())
