"""The command line: the only place that prints or exits."""

from __future__ import annotations

import atexit
import gc
import io
import logging
import os
import resource
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import cmbot
from cmbot.cli.command import Command, UsageError, parsed, parser_of
from cmbot.cli.completion import ASKED, completions, install, script
from cmbot.cli.console import ExitStatus, LostOutputError, discard, err, out, raised_again
from cmbot.cli.creation import NewCommand
from cmbot.cli.identification import IdentifyCommand, LocateCommand
from cmbot.cli.inspection import CheckCommand, DoctorCommand, ScenesCommand, SchemaCommand, VerifyCommand
from cmbot.cli.planning import CampaignCommand, EvaluateCommand, PlanCommand
from cmbot.cli.simulation import ExciteCommand, ReproduceCommand, SimulateCommand
from cmbot.cli.stances import StandCommand, TourCommand, WalkCommand
from cmbot.cli.views import CompareCommand, ExportCommand, ReplayCommand, ReportCommand
from cmbot.common.errors import (
    LONGEST_MESSAGE,
    CmbotError,
    InputError,
    PlanningError,
    one_line,
    whole_sentences,
)

COMMANDS: dict[str, type[Command]] = {
    kind.verb(): kind
    for kind in (
        *(PlanCommand, StandCommand, WalkCommand, TourCommand, CampaignCommand, NewCommand),
        *(ReplayCommand, ReportCommand, CompareCommand, ExportCommand, SimulateCommand, ExciteCommand),
        *(VerifyCommand, IdentifyCommand, LocateCommand, ReproduceCommand, CheckCommand, ScenesCommand),
        *(EvaluateCommand, SchemaCommand, DoctorCommand),
    )
}
"""The commands by what they are called."""

# What is given in place of a command.
_COMMAND_SYNONYMS = {
    "--help": "Show this help, or with a command before it that of the command.",
    "--help-all": "Show the help of all commands, as a manual.",
    "--version": "Print the version.",
    "--debug": "With a command: show the traceback of an error, and what is logged.",
    "--install-completion": "Make the present shell (bash, zsh, fish) complete commands, options and scenes.",
    "--show-completion": "Print what that installs.",
}


# What to do with a file that was given in place of another one, by what its format begins with.
_OTHER_FILES = {
    "cmbot-scene": "cmbot plan {file} plans it",
    "cmbot-campaign": "cmbot campaign {file} plans it",
    "cmbot-measurements": "cmbot identify {file} reads it",
    "cmbot-stiffness": "a scene names it as identified",
    "cmbot-joint-limits": "a scene names it as robot.limits",
    "cmbot-elasticity": "a scene names it as robot.elasticity",
    "cmbot-plan": "cmbot replay {folder} shows it",
    "cmbot-tracking": "cmbot report {folder} shows it",
    "cmbot-walk": "cmbot replay {folder} shows it",
    "cmbot-tour": "{folder}/index.html shows it",
    "xml": "cmbot check inspects a URDF",
}


def main() -> None:
    """Run the command line; turn errors into one line and an exit status."""
    sys.excepthook = _report
    warnings.showwarning = _show_warning
    if _debugging():
        logging.basicConfig(format="%(asctime)s %(name)s: %(message)s")
        logging.getLogger("cmbot").setLevel(logging.DEBUG)
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


def _run(words: Sequence[str]) -> int:
    try:
        with raised_again():
            return _called(words)
    except UsageError as error:
        message, where = one_line(error), f" See: {error.command} --help"
        where = where if message.endswith("?") else f".{where}"
        _print_error(f"{whole_sentences(message, LONGEST_MESSAGE - len(where))}{where}")
        return ExitStatus.BAD_INPUT
    except CmbotError as error:
        if isinstance(error, InputError) and error.holds:
            file = Path(error.source)
            error.add_hint(_OTHER_FILES[error.holds].format(file=file, folder=file.parent))
        if _debugging():
            traceback.print_exc()
        else:
            _print_error(str(error))
        return exit_status(error)
    except (MemoryError, ImportError) as error:
        # Libraries are mapped when they are first used: under a limit that may fail.
        limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        missing = isinstance(error, ModuleNotFoundError) or not limited
        if _debugging() or (isinstance(error, ImportError) and missing):
            raise
        _print_error("there is not enough memory: close other programs, or raise the limit (ulimit -v)")
        return ExitStatus.FAILED


def _called(words: Sequence[str]) -> int:
    """Do what the words say; return the exit status."""
    if ASKED in os.environ:
        out.print("\n".join(completions(COMMANDS, os.environ)))
        return ExitStatus.DONE
    match words:
        case [] | ["--help", *_]:
            _print_help()
            return ExitStatus.DONE if words else ExitStatus.BAD_INPUT
        case ["--help-all", *_]:
            _print_help()
            for command in COMMANDS.values():
                out.print(f"\n\n{parser_of(command).format_help()}", end="")
        case ["--version", *_]:
            out.print(cmbot.__version__)
        case ["--install-completion", *_]:
            install()
        case ["--show-completion", *_]:
            script()
        case [verb, *options] if verb in COMMANDS:
            return _with_sign(parsed(COMMANDS[verb], options))
        case [word, *_]:
            from cmbot.common.reading.validation import hint

            kind = "option" if word.startswith("-") else "command"
            raise UsageError(f"no such {kind}: {one_line(word)}{hint(word, [*COMMANDS, *_COMMAND_SYNONYMS])}")
    return ExitStatus.DONE


def _with_sign(command: Command) -> int:
    """Run a command, which first shows that it has begun."""
    if command.reads and not getattr(command, "quiet", False):
        err.show_sign("reading …")
    try:
        return command() or ExitStatus.DONE
    finally:
        err.erase_sign()


def _print_help() -> None:
    about = {verb: (kind.__doc__ or "").partition("\n")[0] for verb, kind in COMMANDS.items()}
    width = max(map(len, _COMMAND_SYNONYMS)) + 2
    out.print(
        "Usage: cmbot COMMAND ...\n\nPlan the motion of a robot arm that works from a base that bends.\n"
    )
    out.print("Example: cmbot plan triangle, then open out/triangle/report.html in a browser.")
    for title, told in (("Options", _COMMAND_SYNONYMS), ("Commands", about)):
        out.print(f"\n{title}:")
        for name, text in told.items():
            out.print(f"  {name:<{width}}{text}")
    out.print(
        "\nExit status: 0 done, 2 bad input, 3 no plan, 130 stopped with Ctrl-C, 143 terminated, "
        "1 anything else."
    )


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
        # A second Ctrl-C, after whatever answered the first: Python would end itself by the signal.
        os._exit(ExitStatus.STOPPED)
    if _debugging():
        sys.__excepthook__(kind, error, trace)
    else:
        end = " (a bug in cmbot: --debug shows where)"
        _print_error(whole_sentences(one_line(f"{kind.__name__}: {error}"), LONGEST_MESSAGE - len(end)) + end)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning, such as that an interrupted call was made good, in one line."""
    if not {"--quiet", "-q"} & set(sys.argv):
        err.print(f"warning: {one_line(message)}")


def _debugging() -> bool:
    return "--debug" in sys.argv


def _print_error(text: str) -> None:
    """Print one line; a terminal breaks it between words."""
    terminal = err.is_terminal
    err.print(f"error: {one_line(text)}", style="red" if terminal else "", soft_wrap=not terminal)
