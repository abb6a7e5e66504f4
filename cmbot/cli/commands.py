"""The command line: the only place that prints or exits."""

from __future__ import annotations

import atexit
import gc
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.main
from rich.table import Table

import cmbot
from cmbot.cli.console import JsonOption, QuietOption, err, flat, out, print_json
from cmbot.cli.planning import plan
from cmbot.cli.simulation import reproduce, simulate
from cmbot.cli.views import replay, report
from cmbot.common.errors import CmbotError, InputError, PlanningError, SceneError

if TYPE_CHECKING:
    from cmbot.robot import Finding

__all__ = ["app", "main"]

DONE, FAILED, BAD_INPUT, NO_PLAN = 0, 1, 2, 3
_SCENE_SUFFIXES = (".yaml", ".yml", ".json")

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

# The base of all of Typer's complaints about a command line; Typer does not name it.
_UsageError: Any = typer.BadParameter.__bases__[0]


def main() -> None:
    """Run the command line; turn errors into one line and an exit status."""
    sys.excepthook = _one_line
    # What is left at the end goes with the process: nobody has to look for cycles in it first.
    atexit.register(gc.freeze)
    # Understood before the verb and after it.
    words = [word for word in sys.argv[1:] if word != "--debug"]
    try:
        # Not `app()`: that replaces the hook by its own, and shows errors in a box of many lines.
        sys.exit(typer.main.get_command(app)(words, prog_name="cmbot", standalone_mode=False))
    except _UsageError as error:
        # Without any argument the help has been printed, and there is nothing left to say.
        if message := flat(error.format_message()):
            verb = error.ctx.command_path if error.ctx is not None else "cmbot"
            _print_error(f"{message.rstrip('.')}. See: {verb} --help")
        sys.exit(BAD_INPUT)
    except CmbotError as error:
        if _debugging():
            traceback.print_exc()
        else:
            _print_error(str(error))
        sys.exit(exit_status(error))


def exit_status(error: CmbotError) -> int:
    """Exit status of an error: 2 bad input, 3 no plan, 1 anything else; Ctrl-C, which is none, gives 130."""
    if isinstance(error, InputError):
        return BAD_INPUT
    return NO_PLAN if isinstance(error, PlanningError) else FAILED


def _one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report what should not have happened."""
    if _debugging() or isinstance(error, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
    else:
        _print_error(f"{kind.__name__}: {error} (a bug in cmbot: --debug shows where)")


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


app.command()(plan)
app.command()(replay)
app.command()(report)
app.command()(simulate)
app.command()(reproduce)


@app.command()
def check(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A URDF, a scene file, or a shipped scene's name.")
    ],
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Inspect a URDF or a scene before anything is planned with it.

    Examples: [bold]cmbot check arm.urdf[/bold], [bold]cmbot check triangle[/bold]
    """
    if Path(file).suffix.lower() in (".urdf", ".xml"):
        _check_urdf(Path(file), as_json=as_json, quiet=quiet)
    else:
        _check_scene(file, as_json=as_json, quiet=quiet)


@app.command()
def doctor() -> None:
    """Show versions, where things were loaded from, and what is missing.

    Example: [bold]cmbot doctor[/bold]
    """
    from cmbot.cli.doctor import examine

    symptoms = examine()
    width = max(len(symptom.name) for symptom in symptoms)
    for symptom in symptoms:
        mark = "ok     " if symptom.healthy else "MISSING"
        out.print(f"{mark} {symptom.name:<{width}}  {flat(symptom.found)}")
    if not all(symptom.healthy for symptom in symptoms):
        raise typer.Exit(FAILED)


def _check_urdf(path: Path, *, as_json: bool, quiet: bool) -> None:
    from cmbot.common.validation import counted
    from cmbot.robot import inspect_urdf, overview, parse_urdf

    root = parse_urdf(path)
    findings = inspect_urdf(root)
    errors = sum(finding.severity == "error" for finding in findings)
    found = {} if errors else dict(overview(path, root))
    if as_json:
        told = [asdict(finding) for finding in findings]
        print_json(_check_summary(str(path), "urdf", found, findings=told, usable=not errors))
    else:
        _print_findings(str(path), findings, quiet=quiet)
    if not (as_json or quiet):
        warnings = counted(len(findings) - errors, "warning")
        _print_pairs(found)
        last = f"Not usable: {counted(errors, 'error')}" if errors else "OK: no error"
        out.print(f"{last}, {warnings}.")
    if errors:
        raise typer.Exit(BAD_INPUT)


def _check_scene(file: str, *, as_json: bool, quiet: bool) -> None:
    from cmbot.common.validation import counted
    from cmbot.planning import precheck_scene

    try:
        scene = cmbot.load_scene(file)
    except SceneError as error:
        if error.key or Path(file).suffix.lower() in _SCENE_SUFFIXES or not _is_file(Path(file)):
            raise
        # Nothing in it could be read as a scene's.
        expected = "a URDF (.urdf, .xml) or a scene file (.yaml, .yml, .json)"
        raise InputError(file, "", f"a file that is neither ({error.got})", expected) from error
    seen = precheck_scene(scene)
    if as_json:
        told = [asdict(finding) for finding in seen.warnings]
        print_json(_check_summary(file, "scene", dict(seen.found), findings=told))
    elif not quiet:
        _print_findings(file, seen.warnings, quiet=quiet)
        _print_pairs(dict(seen.found))
        verb = f"cmbot plan {flat(file)}"
        warnings = counted(len(seen.warnings), "warning")
        out.print(
            f"{warnings}; {verb} would have to deal with {'it' if len(seen.warnings) == 1 else 'them'}."
            if seen.warnings
            else "No warning. Looked at: the start, and whether the stretched arm reaches the legs' ends. "
            f"Not looked at: obstacles, joint ranges and limits on the way; {verb} finds out."
        )


def _check_summary(
    file: str,
    kind: str,
    found: Mapping[str, str],
    *,
    findings: Sequence[Mapping[str, object]] = (),
    usable: bool = True,
) -> dict[str, Any]:
    return {
        "verb": "check",
        "file": file,
        "kind": kind,
        "usable": usable,
        "findings": list(findings),
        "found": dict(found),
    }


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long
        return False


def _print_findings(file: str, findings: Sequence[Finding], *, quiet: bool) -> None:
    for finding in findings:
        if finding.severity == "error" or not quiet:
            where = f"{finding.severity}: {file}: {finding.key}"
            out.print(flat(f"{where}: got {finding.got}, expected {finding.expected}"))


def _print_pairs(found: Mapping[str, str]) -> None:
    if out.is_terminal and found:
        table = Table(show_header=False)
        for name, value in found.items():
            table.add_row(name, flat(value))
        out.print(table)
        return
    for name, value in found.items():
        out.print(f"{name:<34}{flat(value)}")
