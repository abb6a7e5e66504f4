"""The command that identifies stiffness from measurements: `cmbot identify`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import cmbot
from cmbot.cli.console import (
    ForceOption,
    JsonOption,
    QuietOption,
    complete_scene,
    flat,
    out,
    print_json,
    print_table,
)
from cmbot.cli.views import require_new
from cmbot.common.errors import InputError
from cmbot.common.installation import scene_folder

if TYPE_CHECKING:
    from cmbot.identification import Identification, MeasuringSetup, Proposal

__all__ = ["identify"]


SourcesArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="FILE",
        help="Files of measurements; with --propose a scene, or those files for more postures.",
        autocompletion=complete_scene,
    ),
]
OutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="File to write; named by FILE if left out.")
]
ProposeOption = Annotated[
    int | None, typer.Option("--propose", help="Propose so many postures to measure in.", min=1, max=100)
]
JobOption = Annotated[
    Path | None, typer.Option("--job", help="With --propose: a plan directory, whose motion counts.")
]
WeightOption = Annotated[
    float | None, typer.Option("--weight", help="With --propose: kg that are hung on; 5 if left out.")
]
GaugeOption = Annotated[
    float | None, typer.Option("--gauge", help="With --propose: error of the gauge, mm; 0.1 if left out.")
]
AxesOption = Annotated[
    str, typer.Option("--axes", help="With --propose: components that are measured, such as z.")
]
MisfitOption = Annotated[
    bool,
    typer.Option("--accept-misfit", help="Use measurements that plainly do not fit, with larger errors."),
]


def identify(
    sources: SourcesArgument,
    output: OutputOption = None,
    propose: ProposeOption = None,
    job: JobOption = None,
    weight: WeightOption = None,
    gauge: GaugeOption = None,
    axes: AxesOption = "xyz",
    accept_misfit: MisfitOption = False,
    force: ForceOption = False,
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
        made, target = _propose(sources, propose, output, job, given, axes, force=force)
        if as_json:
            print_json({"verb": "identify", "file": str(target), **_promised(made)})
        elif not quiet:
            _print_proposal(made, target, sources)
        return
    from cmbot.archive import write_file
    from cmbot.identification import stiffness_text

    target = output if output is not None else Path(f"{sources[-1].removesuffix('.yaml')}.stiffness.yaml")
    found = cmbot.identify(*sources, accept_misfit=accept_misfit)
    require_new(target, force)
    names = ", ".join(Path(source).name for source in sources)
    write_file(target, stiffness_text(found.stiffness, names).encode())
    if as_json:
        print_json({"verb": "identify", "file": str(target), **_summary(found)})
    elif not quiet:
        _print_identification(found, target)


def _print_proposal(made: Proposal, sheet: Path, sources: list[str]) -> None:
    from cmbot.identification import proposal_remarks

    for line in proposal_remarks(made):
        out.print(flat(line))
    all_sheets = (*(sources if made.measured else ()), str(sheet))
    out.print(f"Sheet to fill in: {flat(sheet)}; then: cmbot identify {flat(' '.join(all_sheets))}")


def _print_identification(found: Identification, target: Path) -> None:
    from cmbot.identification import HEADINGS, identified_rows, remarks

    print_table("Stiffness", HEADINGS, list(identified_rows(found)), text_columns=1)
    for line in remarks(found):
        out.print(flat(line))
    out.print(f"Written to {flat(target)}; in a scene: identified: {flat(target)}")


def _propose(
    sources: list[str],
    number: int,
    output: Path | None,
    job: Path | None,
    given: dict[str, float | None],
    axes: str,
    *,
    force: bool,
) -> tuple[Proposal, Path]:
    """Propose postures, and write the sheet."""
    from cmbot.archive import write_file
    from cmbot.identification import MeasuringSetup, is_sheet, job_postures, propose, require_axes

    known, setup = None, MeasuringSetup()
    if is_sheet(sources[0]):
        known = cmbot.identify(*sources)
        scene, setup = known.measurements[-1].scene, known.measurements[-1].setup
        called, stem = scene.source, f"{sources[0].removesuffix('.yaml')}_{len(sources) + 1}"
    elif len(sources) > 1:
        raise InputError(sources[1], "", "a second file", "one scene, or files of measurements")
    else:
        scene, called = cmbot.load_scene(sources[0]), sources[0]
        stem = f"{scene.name}.measurements"
    target = output if output is not None else Path(f"{stem}.yaml")
    setup = _changed(setup, {name: value for name, value in given.items() if value is not None})
    if job is None and known is not None and known.job is not None:
        along = known.job
    else:
        along = job_postures(scene if job is None else cmbot.load_plan(job))
    require_axes(axes, "cmbot identify", "--axes")
    require_new(target, force)
    made = propose(scene, number, along, setup, axes=axes, known=known)
    write_file(target, made.sheet(_from(target, called)).encode())
    return made, target


def _changed(setup: MeasuringSetup, given: dict[str, float]) -> MeasuringSetup:
    """What is measured with, with what the options give; errors name them."""
    from cmbot.common.validation import validated
    from cmbot.identification import MeasuringSetup

    own = setup.model_dump(include=set(MeasuringSetup.model_fields))
    try:
        return validated(MeasuringSetup, own | given, "cmbot identify", InputError)
    except InputError as error:
        option = "--weight" if error.key == "weight_kg" else "--gauge"
        raise InputError(error.source, option, error.got, error.expected) from error


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
    if path.parent == scene_folder():
        return path.stem
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
        "fit": {
            part.kind: {"probability": part.probability, "errors_times": part.scale} for part in found.parts
        },
        "worst_rows": [
            {
                "file": found.measurements[slip.label.sheet].source,
                "key": f"measurements[{slip.label.row}].{slip.label.kind}",
                "standard_deviations": slip.deviations,
                "plain": slip.significant,
            }
            for slip in found.slips
        ],
        "sag_rms_m": None if after is None else after.rms,
        "sag_error_95": None if after is None else after.length_95,
        "sag_vector_error_95": None if after is None else after.share_95,
        "words": list(remarks(found)),
    }
