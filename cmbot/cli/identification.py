"""The commands that find from measurements how stiff what is, and where: `identify` and `locate`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cmbot
from cmbot.cli.command import Writing, argument, option, options_named, require_new
from cmbot.cli.completion import complete_scene
from cmbot.cli.console import out, print_lines, print_table
from cmbot.common.errors import InputError, one_line
from cmbot.common.installation import scene_folder

if TYPE_CHECKING:
    from cmbot.identification import Identification, Location, Proposal


@dataclass(frozen=True, kw_only=True)
class IdentifyCommand(Writing):
    """Find out how stiff base, links and joints are, from how far a weight moves the tool.

    With --propose the postures in which that tells most, as a sheet to fill in, and how exact the tool will
    be. Without it the stiffness with its errors, as a file that scenes name: identified.

    Example: cmbot identify triangle --propose 8, then cmbot identify triangle.measurements.yaml
    """

    sources: tuple[str, ...] = argument(
        "Files of measurements; with --propose or --table a scene, or those files, too.",
        "FILE",
        complete=complete_scene,
    )
    output: Path | None = option(None, "File to write; named by FILE if left out.", "--output", "-o")
    table: Path | None = option(
        None,
        "With a scene or sheet: a table, a posture a row: the joints, weight_kg, dx, dy, dz (mm), record, "
        "gauge_sd_mm.",
        metavar="FILE",
    )
    propose: int | None = option(None, "Propose so many postures to measure in.", least=1, most=100)
    job: Path | None = option(None, "a plan directory, whose motion counts.", needs=["--propose", "--table"])
    weight: float | None = option(None, "kg that are hung on; 5 if left out.", needs=["--propose"])
    gauge: float | None = option(
        None, "error of the gauge, mm, of rows without one; 0.1 if left out.", needs=["--propose", "--table"]
    )
    axes: str = option("xyz", "components that are measured, such as z.", needs=["--propose"])
    accept_misfit: bool = option(False, "Use measurements that plainly do not fit, with larger errors.")

    def __call__(self) -> None:
        if self.propose is not None:
            self._propose(self.propose)
            return
        named = self.sources if self.table is None else (str(self.table),)
        target = self.output or Path(f"{Path(named[-1]).with_suffix('')}.stiffness.yaml")
        found = cmbot.identify(*self._sheets(), accept_misfit=self.accept_misfit)
        names = ", ".join(Path(source).name for source in named)
        text = cmbot.identification.stiffness_text(found.stiffness, names)
        self.write(target, text, lambda: _summary(found), lambda: _print_identification(found, target))

    def _sheets(self) -> tuple[Any, ...]:
        """The sheets that are given, and those of a table."""
        told, table = cmbot.identification, self.table
        if given := [source for source in self.sources if source.lower().endswith(".csv")]:
            raise InputError(given[0], "", "a table", f"cmbot identify SCENE --table {given[0]}")
        if table is None:
            return self.sources
        sheets = [source for source in self.sources if told.is_sheet(source)]
        scenes = [source for source in self.sources if source not in sheets]
        if len(scenes) > 1:
            raise InputError(scenes[1], "", "a second scene", "one scene, or sheets, with --table")
        scene = scenes[0] if scenes else told.read_measurements(sheets[0]).scene.source
        along = told.job_postures(cmbot.load_scene(scene) if self.job is None else cmbot.load_plan(self.job))
        with options_named({"gauge_sd_mm": "--gauge"}):
            return (*sheets, *told.read_deflections(table, scene, gauge_sd_mm=self.gauge, job=along))

    def _propose(self, number: int) -> None:
        """Propose postures, and write the sheet."""
        sources, job = self.sources, self.job
        known, setup, sheets = None, cmbot.identification.MeasuringSetup(), self._sheets()
        if self.table is not None or cmbot.identification.is_sheet(sources[0]):
            known = cmbot.identify(*sheets, accept_misfit=self.accept_misfit)
            scene, setup = known.measurements[-1].scene, known.measurements[-1].setup
            sources = tuple(each for each in sources if each in sheets)
            called, files = scene.source, [*sources, *[self.table] * (self.table is not None)]
            stem = f"{Path(self.table or sources[0]).with_suffix('')}_{len(files) + 1}"
        elif len(sources) > 1:
            raise InputError(sources[1], "", "a second file", "one scene, or files of measurements")
        else:
            scene, called = cmbot.load_scene(sources[0]), sources[0]
            stem = f"{scene.name}.measurements"
        target = self.output or Path(f"{stem}.yaml")
        given = {"weight_kg": self.weight, "gauge_sd_mm": self.gauge}
        with options_named({"weight_kg": "--weight", "gauge_sd_mm": "--gauge"}, "cmbot identify"):
            setup = setup.changed(**{name: value for name, value in given.items() if value is not None})
        if job is None and known is not None and known.job is not None:
            along = known.job
        else:
            along = cmbot.identification.job_postures(scene if job is None else cmbot.load_plan(job))
        cmbot.identification.require_axes(self.axes, "cmbot identify", "--axes")
        require_new(target, self.force)
        made = cmbot.identification.propose(scene, number, along, setup, axes=self.axes, known=known)

        def say() -> None:
            print_lines(cmbot.identification.proposal_remarks(made))
            words = [*(sources if known else ()), str(target)]
            words += [] if self.table is None else ["--table", str(self.table)]
            then = one_line(" ".join(words))
            out.print(f"Sheet to fill in: {one_line(target)}; then: cmbot identify {then}")

        self.write(target, made.sheet(_from(target, called)), lambda: _promised(made), say)


def _print_identification(found: Identification, target: Path) -> None:
    told = cmbot.identification
    print_table("Stiffness", told.HEADINGS, told.identified_rows(found))
    if rows := list(told.mode_rows(found)):
        print_table("Frequencies", told.MODE_HEADINGS, rows)
    print_lines(told.remarks(found))
    rigid = found.stiffness.joints and found.measurements[-1].scene.robot.joints == "rigid"
    needs = ", with robot.joints: elastic in place of rigid" if rigid else ""
    out.print(f"Written to {one_line(target)}; in a scene: identified: {one_line(target)}{needs}")


def _promised(made: Proposal) -> dict[str, object]:
    known, before = _sag(made.after), made.before.length_95
    return {"postures": made.q.tolist(), **known, "sag_error_95_as_modelled": before}


def _sag(after: cmbot.identification.SagAlong | None) -> dict[str, object]:
    """How exactly the sag is known after measurements."""
    names = {"sag_rms_m": "rms", "sag_error_95": "length_95", "sag_vector_error_95": "share_95"}
    return {key: after and getattr(after, name) for key, name in names.items()}


def _from(target: Path, scene: str) -> str:
    """How a file names a scene: by its name, or by a path that starts where the file lies."""
    path = Path(scene)
    if not path.is_file():
        return scene
    if path.parent == scene_folder():
        return path.stem
    return os.path.relpath(path.resolve(), target.resolve().parent)


def _summary(found: Identification) -> dict[str, object]:
    names, directions = cmbot.identification.unseen(found)
    factors = {each.name: each.factor for each in (*found.stiffness.links, *found.stiffness.joints)}
    fit = {part.kind: {"probability": part.probability, "errors_times": part.scale} for part in found.parts}
    measured = found.stiffness.measured
    return {
        "factors": factors,
        "measured": measured and measured.model_dump(mode="json", exclude_none=True),
        "base": None if found.stiffness.base is None else found.stiffness.base.stiffness,
        "not_seen": list(names),
        "base_directions_not_seen": directions,
        "fit": fit,
        "worst_rows": [
            {
                "file": found.measurements[slip.label.sheet].source,
                "key": f"measurements[{slip.label.row}].{slip.label.kind}",
                "standard_deviations": slip.deviations,
                "plain": slip.significant,
            }
            for slip in found.slips
        ],
        "frequencies": [each._asdict() | {"label": each.label._asdict()} for each in found.matched],
        **_sag(found.after),
        "words": list(cmbot.identification.remarks(found)),
    }


@dataclass(frozen=True, kw_only=True)
class LocateCommand(Writing):
    """Find out where a workpiece is, from places that the tool touched on it.

    With --propose the corners to touch, as a sheet to fill in, and how exact the place will be. Without it
    the frame's pose and how exactly it is known, as blocks that go into the scene: frames, uncertainty.

    Example: cmbot locate triangle --propose 4, then cmbot locate triangle.touches.yaml
    """

    source: str = argument(
        "A file of touches, YAML or CSV; with --propose a scene.", "FILE", complete=complete_scene
    )
    output: Path | None = option(None, "File to write; named by FILE if left out.", "--output", "-o")
    scene: str | None = option(None, "Scene in place of the file's; a CSV file needs one.", metavar="SCENE")
    propose: int | None = option(None, "Propose so many corners to touch.", least=1, most=100)

    def __call__(self) -> None:
        if self.propose is not None:
            self._propose(self.propose)
            return
        touches = cmbot.identification.read_touches(self.source, self.scene)
        found = cmbot.identification.located(touches)
        remarks = list(cmbot.identification.location_remarks(found, touches))
        target = self.output or Path(f"{Path(self.source).with_suffix('')}.location.yaml")

        def say() -> None:
            print_lines(remarks)
            out.print(f"Written to {one_line(target)}: {_use(found)}.")

        self.write(target, _blocks(found, remarks), lambda: {**_located(found), "remarks": remarks}, say)

    def _propose(self, number: int) -> None:
        """Propose corners, and write the sheet."""
        from cmbot.common.reading.validation import counted
        from cmbot.common.reading.yaml_reader import yaml_text

        if Path(self.source).suffix.lower() == ".csv":
            raise InputError(self.source, "--propose", "a CSV file", "a scene, whose corners can be touched")
        if self.output is not None and self.output.suffix.lower() not in (".yaml", ".yml"):
            raise InputError(str(self.output), "--output", "no name of a YAML file", "one that ends in .yaml")
        scene = cmbot.load_scene(self.source)
        features, covariance = cmbot.identification.features_to_touch(scene, number)
        target, joints = self.output or Path(f"{scene.name}.touches.yaml"), len(scene.posture)
        frame, X_WF = cmbot.identification.frame_of(scene)
        in_frame = [X_WF[:3, :3].T @ (feature.point - X_WF[:3, 3]) for feature in features]
        points = [[round(float(x), 6) for x in point] for point in in_frame]
        sheet = {
            "format": "cmbot-touches/1",
            "scene": self.source,
            "locates": frame,
            "touch_sd_mm": cmbot.identification.TouchSetup().touch_sd_mm,
            "touches": [{"posture_deg": None, "point": point} for point in points],
        }
        text = (
            f"# Touch each corner with the tool point, and write down the {joints} angles of the joints.\n"
            f"# The points are in {'W' if frame == 'world' else f'the frame {frame} of the scene'}.\n"
        )
        known = cmbot.identification.placement_of(covariance)
        touches = counted(len(points), "touch", "touches")

        def say() -> None:
            out.print(
                f"After {touches} its place will be known within {known.mm:.2f} mm and {known.deg:.3f} deg, "
                "one standard deviation in the worst direction."
            )
            out.print(f"Sheet to fill in: {one_line(target)}; then: cmbot locate {one_line(target)}")

        data = {"touches": points, "shift_mm": known.mm, "turn_deg": known.deg}
        self.write(target, text + yaml_text(sheet), lambda: data, say)


def _located(found: Location) -> dict[str, Any]:
    """What was found, as JSON has it."""
    import numpy as np

    known = found.placement
    return {
        "frame": found.frame,
        "xyz": found.X_WF[:3, 3].tolist(),
        "rpy_deg": np.degrees(found.rpy).tolist(),
        "mm": known.mm,
        "deg": known.deg,
        "covariance": found.covariance.tolist(),
        "left_out": list(found.left_out),
        "not_fixed": list(found.not_fixed),
    }


def _use(found: Location) -> str:
    """What to do with the blocks, and what then says how exactly the place is known."""
    if found.frame == "world":
        return (
            "with from and legs' to: {frame: workpiece, ...} in the scene's strokes (by is along W) and "
            f"frame: workpiece in its obstacles these follow it; then {_exactly(found)} says how exactly"
        )
    return f"its blocks go into the scene, where {_exactly(found)} says how exactly the tool's path is known"


def _exactly(found: Location) -> str:
    """The block that says how exactly the workpiece is known, relative to where the base is."""
    known = found.placement
    return (
        f"uncertainty: {{workpiece: {{mm: {known.mm:.4g}, deg: {known.deg:.4g}}}, foot: {{mm: 0, deg: 0}}}}"
    )


def _blocks(found: Location, remarks: list[str]) -> str:
    """The blocks of a scene that say where the workpiece is, below what was found in words."""
    told = _located(found)
    name = "workpiece" if found.frame == "world" else found.frame
    xyz, rpy = ([round(x, 7) for x in told[key]] for key in ("xyz", "rpy_deg"))
    lines = [f"# {one_line(line)}" for line in remarks]
    lines.append(f"frames: {{{name}: {{xyz: {xyz}, rpy_deg: {rpy}}}}}")
    # Nothing in the scene follows a frame that it did not have, so its path is known no better.
    if found.frame != "world":
        lines.append(f"{_exactly(found)}  # relative to the foot")
    return "\n".join([*lines, ""])
