"""The command line: the only place that prints or exits."""

from __future__ import annotations

import atexit
import gc
import sys
import traceback
import warnings
from types import TracebackType
from typing import Annotated, Any

import typer
import typer.main

import cmbot
from cmbot.cli.console import ExitStatus, err, flat, out
from cmbot.cli.inspection import check, doctor
from cmbot.cli.planning import plan
from cmbot.cli.simulation import reproduce, simulate
from cmbot.cli.views import replay, report
from cmbot.common.errors import CmbotError, InputError, PlanningError

__all__ = ["app", "main"]

app = typer.Typer(
    name="cmbot",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Plan the motion of a robot arm that works from a base that bends.\n\n"
    "Example: [bold]cmbot plan triangle[/bold], then open out/triangle/report.html in a browser.",
    epilog="Exit status: 0 done, 2 bad input, 3 no plan, 130 stopped with Ctrl-C, 1 anything else.",
)

# The base of Typer's errors about a command line; Typer does not export it.
_UsageError: Any = typer.BadParameter.__bases__[0]


def main() -> None:
    """Run the command line; turn errors into one line and an exit status."""
    sys.excepthook = _one_line
    warnings.showwarning = _show_warning
    # No search for reference cycles at exit.
    atexit.register(gc.freeze)
    # --debug is allowed before the verb and after it.
    words = [word for word in sys.argv[1:] if word != "--debug"]
    try:
        # Not `app()`: it replaces the hook and prints errors in a box of many lines.
        sys.exit(typer.main.get_command(app)(words, prog_name="cmbot", standalone_mode=False))
    except _UsageError as error:
        # The message is empty where the help was printed.
        if message := flat(error.format_message()):
            verb = error.ctx.command_path if error.ctx is not None else "cmbot"
            _print_error(f"{message.rstrip('.')}. See: {verb} --help")
        sys.exit(ExitStatus.BAD_INPUT)
    except CmbotError as error:
        if _debugging():
            traceback.print_exc()
        else:
            _print_error(str(error))
        sys.exit(exit_status(error))


def exit_status(error: CmbotError) -> ExitStatus:
    """Return the exit status of an error; Ctrl-C, which is none, gives 130."""
    if isinstance(error, InputError):
        return ExitStatus.BAD_INPUT
    return ExitStatus.NO_PLAN if isinstance(error, PlanningError) else ExitStatus.FAILED


def _one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an unexpected exception."""
    if _debugging() or isinstance(error, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
    else:
        _print_error(f"{kind.__name__}: {error} (a bug in cmbot: --debug shows where)")


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning, such as that an interrupted call was made good, in one line."""
    if not {"--quiet", "-q"} & set(sys.argv):
        err.print(f"warning: {flat(message)}")


def _debugging() -> bool:
    return "--debug" in sys.argv


def _print_error(text: str) -> None:
    err.print(f"error: {flat(text)}", style="red" if err.is_terminal else "")


def _print_version(wanted: bool) -> None:
    if wanted:
        out.print(cmbot.__version__)
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    del debug, version


for _verb in (plan, replay, report, simulate, reproduce, check, doctor):
    app.command()(_verb)
