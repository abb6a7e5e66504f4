"""The verb of the command line that identifies stiffness from measurements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import cmbot
from cmbot.cli.console import JsonOption, QuietOption, flat, out, print_json, print_table
from cmbot.cli.views import require_new
from cmbot.common.errors import InputError

if TYPE_CHECKING:
    from cmbot.identification import Identification, Proposal

__all__ = ["identify"]


def identify(
    source: Annotated[
        str,
        typer.Argument(metavar="FILE", help="A file of measurements; with --propose a scene."),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; beside FILE if left out.")
    ] = None,
    propose: Annotated[
        int | None, typer.Option("--propose", help="Propose so many postures to measure in.", min=1, max=100)
    ] = None,
    job: Annotated[
        Path | None, typer.Option("--job", help="With --propose: a plan directory, whose motion counts.")
    ] = None,
    weight: Annotated[float, typer.Option("--weight", help="With --propose: kg that are hung on.")] = 5.0,
    gauge: Annotated[float, typer.Option("--gauge", help="With --propose: error of the gauge, mm.")] = 0.1,
    axes: Annotated[
        str, typer.Option("--axes", help="With --propose: components that are measured, such as z.")
    ] = "xyz",
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Find out how stiff base, links and joints are, from how far a weight moves the tool.

    With --propose the postures in which that tells most, as a sheet to fill in, and how exact the tool will
    be. Without it the stiffness with its errors, as a file that scenes name: identified.

    Example: [bold]cmbot identify triangle --propose 8[/bold], then
    [bold]cmbot identify triangle.measurements.yaml[/bold]
    """
    if propose is not None:
        given = {"weight_kg": weight, "gauge_sd_mm": gauge}
        made, target = _propose(source, propose, output, job, given, axes, force=force)
        if as_json:
            print_json({"verb": "identify", "file": str(target), **_promised(made)})
        elif not quiet:
            from cmbot.identification import proposal_remarks

            for line in proposal_remarks(made):
                out.print(flat(line))
            out.print(f"Sheet to fill in: {flat(target)}")
        return
    from cmbot.archive import write_file
    from cmbot.identification import stiffness_text

    target = output if output is not None else Path(f"{source.removesuffix('.yaml')}.stiffness.yaml")
    require_new(target, force)
    found = cmbot.identify(source)
    write_file(target, stiffness_text(found.stiffness, Path(source).name).encode())
    if as_json:
        print_json({"verb": "identify", "file": str(target), **_summary(found)})
    elif not quiet:
        from cmbot.identification import HEADINGS, identified_rows, remarks

        print_table("Stiffness", HEADINGS, list(identified_rows(found)), text_columns=1)
        for line in remarks(found):
            out.print(flat(line))
        out.print(f"Written to {flat(target)}; in a scene: identified: {flat(target)}")


def _propose(
    source: str,
    number: int,
    output: Path | None,
    job: Path | None,
    given: dict[str, float],
    axes: str,
    *,
    force: bool,
) -> tuple[Proposal, Path]:
    """Propose postures, and write the sheet."""
    from cmbot.archive import write_file
    from cmbot.common.validation import validated
    from cmbot.identification import MeasuringSetup, job_postures, propose

    scene = cmbot.load_scene(source)
    target = output if output is not None else Path(f"{scene.name}.measurements.yaml")
    require_new(target, force)
    try:
        setup = validated(MeasuringSetup, given, "cmbot identify", InputError)
    except InputError as error:
        option = "--weight" if error.key == "weight_kg" else "--gauge"
        raise InputError(error.source, option, error.got, error.expected) from error
    along = job_postures(scene if job is None else cmbot.load_plan(job))
    made = propose(scene, number, along, setup, axes=axes)
    write_file(target, made.sheet(_from(target, source)).encode())
    return made, target


def _promised(made: Proposal) -> dict[str, object]:
    after = made.after
    return {
        "postures": made.q.tolist(),
        "sag_rms_m": after.rms,
        "sag_error_95": after.length_95,
        "sag_vector_error_95": after.share_95,
        "sag_error_95_as_modelled": made.before.length_95,
    }


def _from(target: Path, scene: str) -> str:
    """How a file names a scene: by its name, or by a path that starts where the file lies."""
    path = Path(scene)
    if not path.is_file():
        return scene
    import os

    return os.path.relpath(path.resolve(), target.resolve().parent)


def _summary(found: Identification) -> dict[str, object]:
    from cmbot.identification import remarks, unseen

    names, directions = unseen(found)
    factors = {each.name: each.factor for each in (*found.stiffness.links, *found.stiffness.joints)}
    after = found.after
    return {
        "factors": factors,
        "base": None if found.stiffness.base is None else found.stiffness.base.stiffness,
        "not_seen": list(names),
        "base_directions_not_seen": directions,
        "misfit_probability": found.misfit_share,
        "sag_rms_m": None if after is None else after.rms,
        "sag_error_95": None if after is None else after.length_95,
        "sag_vector_error_95": None if after is None else after.share_95,
        "words": list(remarks(found)),
    }
