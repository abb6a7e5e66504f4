"""The command that identifies stiffness from measurements: `cmbot identify`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cmbot
from cmbot.cli.command import Writing, argument, option, options_named
from cmbot.cli.completion import complete_scene
from cmbot.cli.console import out, print_table
from cmbot.cli.views import require_new
from cmbot.common.errors import InputError, one_line
from cmbot.common.installation import scene_folder

if TYPE_CHECKING:
    from cmbot.identification import Identification, MeasuringSetup, Proposal


@dataclass(frozen=True, kw_only=True)
class IdentifyCommand(Writing):
    """Find out how stiff base, links and joints are, from how far a weight moves the tool.

    With --propose the postures in which that tells most, as a sheet to fill in, and how exact the tool will
    be. Without it the stiffness with its errors, as a file that scenes name: identified.

    Example: cmbot identify triangle --propose 8, then cmbot identify triangle.measurements.yaml
    """

    sources: tuple[str, ...] = argument(
        "Files of measurements; with --propose a scene, or those files for more postures.",
        "FILE",
        complete=complete_scene,
    )
    output: Path | None = option(None, "File to write; named by FILE if left out.", "--output", "-o")
    table: Path | None = option(
        None,
        "With a scene: a table of deflections, a posture a row: the joints, weight_kg, dx, dy, dz (mm).",
        metavar="FILE",
    )
    propose: int | None = option(None, "Propose so many postures to measure in.", least=1, most=100)
    job: Path | None = option(None, "With --propose: a plan directory, whose motion counts.")
    weight: float | None = option(None, "With --propose: kg that are hung on; 5 if left out.")
    gauge: float | None = option(None, "With --propose: error of the gauge, mm; 0.1 if left out.")
    axes: str = option("xyz", "With --propose: components that are measured, such as z.")
    accept_misfit: bool = option(False, "Use measurements that plainly do not fit, with larger errors.")

    def __call__(self) -> None:
        if self.propose is not None:
            self._propose(self.propose)
            return
        from cmbot.archive import write_file
        from cmbot.identification import read_deflections, stiffness_text

        named = self.sources if self.table is None else (str(self.table),)
        target = self.output or Path(f"{Path(named[-1]).with_suffix('')}.stiffness.yaml")
        sheets: Sequence[Any] = self.sources
        if self.table is not None:
            if len(self.sources) > 1:
                raise InputError(self.sources[1], "", "a second file", "one scene with --table")
            sheets = read_deflections(self.table, self.sources[0])
        found = cmbot.identify(*sheets, accept_misfit=self.accept_misfit)
        require_new(target, self.force)
        names = ", ".join(Path(source).name for source in named)
        write_file(target, stiffness_text(found.stiffness, names).encode())
        self.answer(
            lambda: {"file": str(target), **_summary(found)}, lambda: _print_identification(found, target)
        )

    def _propose(self, number: int) -> None:
        """Propose postures, and write the sheet."""
        from cmbot.archive import write_file
        from cmbot.identification import MeasuringSetup, is_sheet, job_postures, propose, require_axes

        sources, job = self.sources, self.job
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
        target = self.output or Path(f"{stem}.yaml")
        given = {"weight_kg": self.weight, "gauge_sd_mm": self.gauge}
        setup = _changed(setup, {name: value for name, value in given.items() if value is not None})
        if job is None and known is not None and known.job is not None:
            along = known.job
        else:
            along = job_postures(scene if job is None else cmbot.load_plan(job))
        require_axes(self.axes, "cmbot identify", "--axes")
        require_new(target, self.force)
        made = propose(scene, number, along, setup, axes=self.axes, known=known)
        write_file(target, made.sheet(_from(target, called)).encode())
        self.answer(
            lambda: {"file": str(target), **_promised(made)},
            lambda: _print_proposal(made, target, sources),
        )


def _print_proposal(made: Proposal, sheet: Path, sources: Sequence[str]) -> None:
    from cmbot.identification import proposal_remarks

    for line in proposal_remarks(made):
        out.print(one_line(line))
    all_sheets = (*(sources if made.measured else ()), str(sheet))
    out.print(f"Sheet to fill in: {one_line(sheet)}; then: cmbot identify {one_line(' '.join(all_sheets))}")


def _print_identification(found: Identification, target: Path) -> None:
    from cmbot.identification import HEADINGS, identified_rows, remarks

    print_table("Stiffness", HEADINGS, list(identified_rows(found)), text_columns=1)
    for line in remarks(found):
        out.print(one_line(line))
    out.print(f"Written to {one_line(target)}; in a scene: identified: {one_line(target)}")


def _changed(setup: MeasuringSetup, given: dict[str, float]) -> MeasuringSetup:
    """What is measured with, with what the options give; errors name them."""
    from cmbot.common.validation import validated
    from cmbot.identification import MeasuringSetup

    own = setup.model_dump(include=set(MeasuringSetup.model_fields))
    with options_named({"weight_kg": "--weight", "gauge_sd_mm": "--gauge"}):
        return validated(MeasuringSetup, own | given, "cmbot identify", InputError)


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
