"""The command group: commands are loaded when they are called, and errors of ours become one line and exit code 1 here.

Exit codes: 0 done, 1 a clear error, 2 wrong usage, 130 stopped by Ctrl-C.  Results go to stdout, everything else to stderr."""

from __future__ import annotations

import errno
import importlib
from typing import Any

import click

from stereorelight import __version__
from stereorelight.errors import OutputError, StereoRelightError

# In the order in which the work flows; the name is the module's, too.
COMMANDS = ("demo", "synth", "board", "calibrate", "check", "rectify", "depth", "passes", "relight", "run", "compare", "export")
STOPPED = 130  # what a shell reports for a program ended by Ctrl-C


def one_line(error: BaseException) -> str:
    """`PlateError: shot.1007.exr: frame missing; ...`, whatever line breaks the message holds."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


class Commands(click.Group):
    """The group that `stereorelight` is."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"stereorelight.cli.{cmd_name}").command
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            from stereorelight.errors import nearest_hint

            raise click.UsageError(f"no command {args[0]!r}{nearest_hint(args[0], COMMANDS)}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except StereoRelightError as error:
            click.echo(one_line(error), err=True)
        except OSError as error:
            if error.errno == errno.EPIPE:  # the reader of a pipe has gone; click knows what to do
                raise
            what = f"{error.filename}: " if error.filename else ""
            remedy = "free some space and run again" if error.errno == errno.ENOSPC else "check the path and its permissions"
            click.echo(one_line(OutputError(f"{what}{(error.strerror or str(error)).lower()}; {remedy}")), err=True)
        except MemoryError:
            click.echo("OutputError: out of memory; try a lower [depth] quality or smaller plates", err=True)
        except KeyboardInterrupt:
            click.echo("stopped; what is finished stays, and the same command goes on from there", err=True)
            ctx.exit(STOPPED)
        return ctx.exit(1)


@click.command(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, "-V", "--version", prog_name="stereorelight")
def main() -> None:
    """Relight live footage shot with two cameras.

    Two plates and a rig go in; depth, positions, normals, light layers and the relit plate come out.
    Begin with `stereorelight demo`.
    """
