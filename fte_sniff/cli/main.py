"""The command group, and the exit code and one-line message of every error."""

from __future__ import annotations

import errno
import gc
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import NoReturn

import click

from fte_sniff.cli.completion import VARIABLE
from fte_sniff.cli.options import with_translated_help
from fte_sniff.cli.settings import read_settings, settings_path
from fte_sniff.cli.streams import (
    EXIT_INTERRUPTED,
    NOT_BEGUN,
    abandon,
    abandon_stdout,
    check_memory,
    interruptible,
    prepare_streams,
    print_err,
)
from fte_sniff.errors import FileError, FteSniffError, reason_of, unreadable, unwritable
from fte_sniff.i18n import set_language, translated

PROGRAM = "fte-sniff"

COMMANDS = (
    *("live", "view", "decode", "findings", "stats", "check", "compare", "report", "hex", "encode"),
    *("bridge", "simulate", "repair", "decoder", "ports", "doctor", "completion"),
)
"""The commands, the most used first; the module of this name in this package defines `command`."""

ENDED_BY_CTRL_C = ("live", "bridge", "simulate")
"""The commands that Ctrl-C ends normally, also before they have begun."""

JUDGING = ("check", "doctor")
"""The commands whose exit code 1 is a verdict."""


class LazyGroup(click.Group):
    """A command group that imports a command when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All commands."""
        return list(COMMANDS)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or fail with the closest name; a file is for `view`."""
        name = args[0]
        if name not in COMMANDS and not name.startswith("-") and not ctx.resilient_parsing:
            from fte_sniff.cli.input_files import is_port_name

            if is_port_name(name):
                ctx.fail(f"{name} is a port, not a command: `{PROGRAM} live` captures it")
            # os.path.exists is False, and raises no error, where a folder is closed.
            if os.path.exists(name):  # noqa: PTH110
                return "view", self.get_command(ctx, "view"), args
            if os.path.splitext(name)[1] or os.sep in name:  # noqa: PTH122
                raise unreadable(name, FileNotFoundError())
            raise click.exceptions.NoSuchCommand(name, possibilities=COMMANDS, ctx=ctx)
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None if there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        if cmd_name in JUDGING:
            check_memory()
        command = import_module(f"fte_sniff.cli.{cmd_name}").command
        gc.freeze()  # what is loaded stays; collections need not look at it, nor the one at exit
        gc.enable()
        assert isinstance(command, click.Command)
        return with_translated_help(command)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name=PROGRAM, prog_name=PROGRAM)
def fte_sniff() -> None:
    """Watch, record and decode the serial protocol of the FTE four-motor controller."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and exit with its exit code."""
    prepare_streams()
    set_language(read_settings(settings_path()).language())
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        with interruptible():
            code = 0
            if asked := os.environ.get(VARIABLE):
                from click.shell_completion import shell_complete

                code = shell_complete(fte_sniff, {}, PROGRAM, VARIABLE, asked)
            else:
                # click's own `main` would turn a closed pipe into exit code 1.
                try:
                    with fte_sniff.make_context(PROGRAM, given) as context:
                        fte_sniff.invoke(context)
                except click.exceptions.Exit as end:
                    code = end.exit_code
                sys.stdout.flush()
        sys.exit(code)
    except FteSniffError as error:
        _exit_with(error.message, error.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        with suppress(OSError):
            click.echo(error.format_message(), err=True)
        abandon(sys.stderr.fileno())
        sys.exit(error.exit_code)
    except click.ClickException as error:
        _exit_with(_one_line(error), error.exit_code)
    except BrokenPipeError:
        abandon_stdout()
        sys.exit(0)
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOMEM):
            raise
        refused = (
            FileError(f"the system reports: {reason_of(error)}; try again, or `{PROGRAM} doctor`")
            if error.filename is None
            else unwritable(error.filename, error)
        )
        _exit_with(str(refused), refused.exit_code)
    except (KeyboardInterrupt, click.Abort):
        abandon_stdout()
        if given[:1] and given[0] in ENDED_BY_CTRL_C:
            print_err(NOT_BEGUN)
            sys.exit(0)
        sys.exit(EXIT_INTERRUPTED)


def _exit_with(message: str, code: int) -> NoReturn:
    with suppress(OSError, FteSniffError):
        sys.stdout.flush()
    abandon_stdout()
    print_err(f"{PROGRAM}: {translated(message)}")
    sys.exit(code)


def _one_line(error: click.ClickException) -> str:
    message = " ".join(error.format_message().split())
    message = re.sub("a valid integer( range)?", "a whole number", message)
    path = getattr(getattr(error, "ctx", None), "command_path", PROGRAM)
    return translated("; ").join(map(translated, (message.rstrip("."), f"see '{path} --help'")))
