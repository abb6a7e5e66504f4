"""The command line: the only place that prints or exits."""

from __future__ import annotations

import atexit
import errno
import gc
import inspect
import io
import sys
import traceback
import warnings
from collections.abc import Callable
from copy import copy
from functools import wraps
from types import TracebackType
from typing import Annotated, Any

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

import cmbot
from cmbot.cli.campaign import campaign
from cmbot.cli.console import ExitStatus, LostOutputError, discard, err, flat, out
from cmbot.cli.creation import new
from cmbot.cli.excitation import excite
from cmbot.cli.identify import identify
from cmbot.cli.inspection import check, doctor, scenes, schema
from cmbot.cli.planning import plan
from cmbot.cli.signals import raised_again
from cmbot.cli.simulation import reproduce, simulate
from cmbot.cli.siting import stand, tour, walk
from cmbot.cli.verification import verify
from cmbot.cli.views import compare, export, replay, report
from cmbot.common.errors import (
    LONGEST_MESSAGE,
    CmbotError,
    InputError,
    PlanningError,
    whole_sentences,
)

__all__ = ["app", "main"]


class _Flags:
    """Help that does not give flags a value: Typer shows ``--force <bool>``."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters of the command, with ``--help``."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for each in params:
            if getattr(each, "is_flag", False) and each.metavar is None:
                each.metavar = ""
        return params


class _Command(_Flags, TyperCommand): ...


class _Group(_Flags, TyperGroup): ...


app = typer.Typer(
    name="cmbot",
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Plan the motion of a robot arm that works from a base that bends.\n\n"
    "Example: [bold]cmbot plan triangle[/bold], then open out/triangle/report.html in a browser.",
    epilog="Exit status: 0 done, 2 bad input, 3 no plan, 130 stopped with Ctrl-C, 143 terminated, "
    "1 anything else.",
)

# The base of Typer's errors about a command line; Typer does not export it.
_UsageError: Any = typer.BadParameter.__bases__[0]


def main() -> None:
    """Run the command line; turn errors into one line and an exit status."""
    sys.excepthook = _report
    warnings.showwarning = _show_warning
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Where the locale's encoding lacks a character of a file's name, as on standard error.
        sys.stdout.reconfigure(errors="backslashreplace")
    # No search for reference cycles at exit.
    atexit.register(gc.freeze)
    # --debug is allowed before the command and after it.
    words = [word for word in sys.argv[1:] if word != "--debug"]
    try:
        status = _run(words)
    except KeyboardInterrupt:
        status = ExitStatus.STOPPED
    sys.exit(_flushed(status))


def _run(words: list[str]) -> int:
    try:
        # Not `app()`: it replaces the hook and prints errors in a box of many lines.
        with raised_again():
            status = typer.main.get_command(_app_for(words))(words, prog_name="cmbot", standalone_mode=False)
        return status if isinstance(status, int) else ExitStatus.DONE
    except _UsageError as error:
        # The message is empty where the help was printed.
        if message := flat(error.format_message()):
            where = f". See: {_called(error, words)} --help"
            option: Any = getattr(error, "param", None)
            if getattr(option, "nargs", 1) > 1:
                numbers = f"{option.opts[0]} takes {option.nargs} numbers: {option.metavar}"
                message = f"{message.rstrip('.')}; {numbers}"
            _print_error(f"{whole_sentences(message.rstrip('.'), LONGEST_MESSAGE - len(where))}{where}")
        return ExitStatus.BAD_INPUT
    except CmbotError as error:
        if _debugging():
            traceback.print_exc()
        else:
            _print_error(str(error))
        return exit_status(error)
    except OSError as error:
        # Of the library's help; `out` has its own.
        if error.errno not in (errno.EPIPE, errno.ENOSPC):
            raise
        return ExitStatus.DONE


def _called(error: Any, words: list[str]) -> str:
    """The command of a wrong command line; an error in how an option is given does not name it."""
    if error.ctx is not None and error.ctx.command_path != "cmbot":
        return str(error.ctx.command_path)
    return f"cmbot {words[0]}" if words[:1] in [[name] for name in _names()] else "cmbot"


def _names() -> list[str]:
    return [getattr(each.callback, "__name__", "") for each in app.registered_commands]


def _app_for(words: list[str]) -> typer.Typer:
    """The app with the called command alone: Typer evaluates the options of each."""
    called = copy(app)
    named = [each for each in app.registered_commands if getattr(each.callback, "__name__", "") in words[:1]]
    called.registered_commands = named or app.registered_commands
    return called


def _flushed(status: int) -> int:
    """Write what is still in the buffer; return the status, another one where it cannot be written."""
    try:
        out.file.flush()
    except BrokenPipeError:
        discard(sys.stdout)
    except OSError as error:
        discard(sys.stdout)
        if status == ExitStatus.DONE:
            _print_error(str(LostOutputError(error)))
            return ExitStatus.FAILED
    return status


def exit_status(error: CmbotError) -> ExitStatus:
    """Return the exit status of an error; Ctrl-C, which is none, gives 130."""
    if isinstance(error, InputError):
        return ExitStatus.BAD_INPUT
    return ExitStatus.NO_PLAN if isinstance(error, PlanningError) else ExitStatus.FAILED


def _report(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an unexpected exception."""
    if issubclass(kind, KeyboardInterrupt):
        return
    if _debugging():
        sys.__excepthook__(kind, error, trace)
    else:
        end = " (a bug in cmbot: --debug shows where)"
        _print_error(whole_sentences(flat(f"{kind.__name__}: {error}"), LONGEST_MESSAGE - len(end)) + end)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning, such as that an interrupted call was made good, in one line."""
    if not {"--quiet", "-q"} & set(sys.argv):
        err.print(f"warning: {flat(message)}")


def _debugging() -> bool:
    return "--debug" in sys.argv


def _print_error(text: str) -> None:
    """Print one line; a terminal breaks it between words."""
    terminal = err.is_terminal
    err.print(f"error: {flat(text)}", style="red" if terminal else "", soft_wrap=not terminal)


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


def _with_sign(command: Callable[..., int | None]) -> Callable[..., int | None]:
    """A command that first shows that it has begun: imports and reading take up to a second."""

    @wraps(command)
    def begun(**options: Any) -> int | None:
        if not options.get("quiet"):
            err.show_sign("reading …")
        try:
            return command(**options)
        finally:
            err.erase_sign()

    return begun


_COMMANDS: tuple[Callable[..., int | None], ...] = (
    *(
        plan,
        stand,
        walk,
        tour,
        campaign,
        new,
        replay,
        report,
        compare,
        export,
        simulate,
        excite,
        verify,
        identify,
        reproduce,
    ),
    *(check, scenes, schema, doctor),
)


def _paragraphs(text: str) -> str:
    """Text whose paragraphs are a line each, which a terminal breaks; but examples have their own lines."""
    parts = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(each if each.startswith("Example") else each.replace("\n", " ") for each in parts)


for _command in _COMMANDS:
    _register = app.command(cls=_Command, help=_paragraphs(_command.__doc__ or ""))
    _register(_command if _command in (new, scenes, schema, doctor) else _with_sign(_command))
