"""The commands that plan, `cmbot plan` and `cmbot campaign`, and `cmbot evaluate` of others' motions."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Any

import cmbot
from cmbot.cli.command import Reporting, Writing, argument, option
from cmbot.cli.completion import complete_scene
from cmbot.cli.console import ConsoleProgress, ExitStatus, err, out, print_lines, print_table, scenes_named
from cmbot.cli.views import plot_files, require_plots
from cmbot.common.errors import InputError, PlanningError, SceneError, one_line
from cmbot.common.installation import scene_folder

# Entries of plan.json that are too long for a summary, or have another form there.
_NOT_PRINTED = ("format", "scene", "floor", "passes")


def _print_options() -> None:
    """Print every option of ``--set``: default, what it may be, meaning."""
    # The models that check the options also wrote the schema.
    schema = json.loads((scene_folder() / "scene.schema.json").read_text(encoding="utf-8"))
    out.print("Options of --set NAME=VALUE, and of a scene file's planner block; --set also takes")
    out.print("keys of the scene file, such as tool_path.legs[0].seconds:")
    for name, entry in schema["$defs"]["PlannerOptions"]["properties"].items():
        default = json.dumps(entry["default"])
        out.print(f"\n{name}={default.strip(chr(34))}  ({_allowed(entry)})")
        out.print(
            f"    {' '.join(entry['description'].replace('``', '').split())}", soft_wrap=not out.is_terminal
        )


def _allowed(option: Mapping[str, Any]) -> str:
    """What an option may be, from its JSON Schema."""
    if "enum" in option:
        return ", ".join(option["enum"])
    if "anyOf" in option:
        return ", ".join(kind.get("const") or _allowed(kind) for kind in option["anyOf"])
    if "prefixItems" in option:
        return f"a list of {option['minItems']} numbers, each {_allowed(option['prefixItems'][0])}"
    kind = {"boolean": "true or false", "integer": "whole, "}.get(option["type"], "")
    if option["type"] == "boolean":
        return kind
    return f"{kind}{option['minimum']:g} to {option['maximum']:g}"


@dataclass(frozen=True, kw_only=True)
class PlanCommand(Writing):
    """Plan a scene, print what was gained, write a plan directory with a replay and a report.

    Examples: cmbot plan triangle -o out/triangle, cmbot plan triangle --set compensate=false --set
    robot.payload_kg=2, cmbot plan triangle -o out/heavier --near out/triangle --set robot.payload_kg=0.5
    """

    scene: str = argument("A scene file, or the name of a shipped scene.", "SCENE", complete=complete_scene)
    output: Path | None = option(None, "Plan directory to write; out/NAME if left out.", "--output", "-o")
    changes: tuple[str, ...] = option(
        (),
        "A planner option, or a value by its key in the scene file, in place of the scene's; repeatable.",
        "--set",
        metavar="NAME=VALUE",
    )
    partial: bool = option(
        False, "Plan the strokes that can be planned where others cannot, and say which.", alone="strokes"
    )
    near: Path | None = option(
        None,
        "Plan near this earlier plan: frames moved by about 20 mm, or loads changed.",
        metavar="DIR",
        alone="strokes",
    )
    options: bool = option(False, "List the planner's options, and stop.", instead=_print_options)
    verbose: bool = option(False, "Print all figures, loads and remarks.")
    figures: bool = option(False, "Draw plots as PNG, SVG and PDF into the plan directory, too.")

    def __call__(self) -> None:
        started = time.perf_counter()
        loaded, options = loaded_scene(self.scene, self.changes)
        directory, drawn = self.output or Path("out") / loaded.name, dict[str, bytes]()

        def require() -> None:
            cmbot.archive.require_free(directory, force=self.force)
            require_plots(self.figures)
            of_units, of_options = cmbot.planning.unit_findings, cmbot.planning.precheck_options
            for finding in () if self.quiet else (*of_units(loaded), *of_options(options, loaded.tool)):
                err.print(finding_in_words(self.scene, finding))

        def planned_scene(progress: ConsoleProgress) -> cmbot.Plan:
            if self.near is None:
                return cmbot.plan(loaded, options=options, partial=self.partial, progress=progress.update)
            earlier = cmbot.load_plan(self.near)
            return cmbot.replan(earlier, loaded.with_options(options), progress=progress.update)

        def write(planned: cmbot.Plan) -> None:
            drawn.update(plot_files(planned, self.figures))
            cmbot.save(planned, directory, force=self.force, added=cmbot.views.pages(planned) | drawn)

        def say() -> None:
            _print_plan(planned, verbose=self.verbose)
            if drawn:
                out.print(f"Figures: {', '.join(drawn)}.")
            folder, page = one_line(directory), one_line(directory / cmbot.views.REPORT)
            more = "" if self.verbose else "; --verbose prints the rest"
            seconds = time.perf_counter() - started
            out.print(f"Written to {folder} in {seconds:.1f} s: open {page} in a browser{more}.")

        planned = self.work_in(directory, require, planned_scene, write, [self.scene])
        self.answer(lambda: _summary(planned, directory), say, directory)


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(Writing):
    """Judge a motion that was planned elsewhere: what it does to the base, beside what a plan does.

    The motion is a table with t and the joints, a ROS JointTrajectory (.json, .yaml) or a plan directory.

    Example: cmbot evaluate triangle --motion motion.csv
    """

    scene: str = argument("A scene file, or the name of a shipped scene.", "SCENE", complete=complete_scene)
    motion: Path = option(MISSING, "The motion to judge.", metavar="FILE")
    output: Path | None = option(None, "Folder for evaluation.json and motion.csv.", "--output", "-o")
    changes: tuple[str, ...] = option((), "As of cmbot plan; repeatable.", "--set", metavar="NAME=VALUE")
    alone: bool = option(False, "Do not plan the scene, to tell the motion beside the plan.")

    def __call__(self) -> None:
        loaded, options = loaded_scene(self.scene, self.changes)
        record, table = cmbot.archive.EVALUATION_FILE, "motion.csv"
        if self.output is not None:
            cmbot.archive.require_absent(self.output, (record, table), force=self.force)
        motion = cmbot.evaluation.read_motion(self.motion, cmbot.planning.robot_of(loaded))
        planned, refused = None, ""
        if not self.alone:
            with scenes_named(self.scene), ConsoleProgress(quiet=self.quiet) as progress:
                try:
                    planned = cmbot.plan(loaded, options=options, progress=progress.update)
                except PlanningError as error:
                    refused = f"There is no plan beside it: {one_line(error)}"
        found = cmbot.evaluate(loaded, motion, options=options, plan=planned)
        remarks = [*found.remarks(), *filter(None, [refused])]
        answer = cmbot.evaluation.evaluation_json(found) | {"remarks": remarks}
        if self.output is not None:
            samples = cmbot.archive.samples_csv(found.samples[0], table, found.samples[1])
            cmbot.archive.write_results(self.output, record, answer, {table: samples}, force=self.force)

        def say() -> None:
            print_table(loaded.name, ("", "motion", "planned"), found.rows())
            print_lines(remarks)
            if self.output is not None:
                out.print(f"Written to {one_line(self.output)}.")

        self.answer(lambda: answer, say, self.output)


def finding_in_words(file: str, finding: cmbot.robot.Finding) -> str:
    """Return a finding in a line, as long as an error's message at most, with the line of its key."""
    # It loads NumPy.
    from cmbot.common.reading.yaml_reader import name_line

    message = InputError(file, finding.key, finding.got, finding.expected)
    name_line(message, file)
    return f"{finding.severity}: {message}"


def loaded_scene(scene: str, changes: Sequence[str]) -> tuple[cmbot.Scene, cmbot.PlannerOptions]:
    """Return a scene and its planner's options with what ``--set`` changes of them."""
    from cmbot.common.reading.validation import validated

    given = _given(scene, changes)
    # A block is that of the scene: start has the name of an option.
    options = {key: given.pop(key) for key in _option_names() if not isinstance(given.get(key, {}), dict)}
    loaded = _with_values(scene, given) if given else cmbot.load_scene(scene)
    return loaded, validated(cmbot.PlannerOptions, asdict(loaded.planner) | options, "--set", InputError)


def changed_scene(scene: str, changes: Sequence[str]) -> cmbot.Scene:
    """Return a scene with what ``--set`` changes of it and of its planner's options."""
    loaded, options = loaded_scene(scene, changes)
    return loaded.with_options(options) if changes else loaded


def _given(scene: str, changes: Sequence[str]) -> dict[str, object]:
    """What ``--set`` changes: planner's options by their names, other values by keys of the scene file."""
    from cmbot.common.reading.validation import hint, shown
    from cmbot.common.reading.yaml_reader import read_yaml, yaml_value

    given: dict[str, object] = {}
    for change in changes:
        key, equals, text = change.partition("=")
        if not equals:
            raise InputError("--set", "", shown(change), "NAME=VALUE, such as start=pinned")
        name = key.removeprefix("planner.")
        if name in given:
            raise InputError("--set", one_line(name), "the same option again", "each option once")
        options = _option_names()
        if name.isidentifier() and name not in (*options, *cmbot.Scene.model_fields, "return"):
            whole = cmbot.scene.whole_key(name, read_yaml(cmbot.scene.scene_path(scene), SceneError))
            meant = f"; did you mean {whole}?" if whole else hint(name, options)
            expected = f"a planner option or a key of the scene file{meant}"
            raise InputError("--set", one_line(name), "an unknown key", expected, () if whole else options)
        given[name] = yaml_value(text, f"--set: {one_line(name)}", InputError)
    return given


def _option_names() -> tuple[str, ...]:
    return tuple(field.name for field in fields(cmbot.PlannerOptions))


def _with_values(scene: str, values: Mapping[str, object]) -> cmbot.Scene:
    """Return a scene with other values, by keys of its file."""
    from cmbot.common.reading.yaml_reader import lines_named, read_yaml

    path = cmbot.scene.scene_path(scene)
    with lines_named(path):
        data = read_yaml(path, SceneError)
        try:
            changed = cmbot.scene.changed_content(data, values)
            return cmbot.scene.scene_from_data(changed, path.parent, str(path))
        except SceneError as error:
            if cmbot.scene.is_within(error.key, values):
                raise SceneError("--set", error.key, error.got, error.expected, error.choices) from error
            raise


def _summary(planned: cmbot.Plan, directory: Path) -> dict[str, Any]:
    told, entries = cmbot.planning, cmbot.archive.plan_data(directory)
    work, job = told.baseline_faults(planned, work=True), told.baseline_faults(planned)
    return {
        "scene": planned.scene.name,
        **{name: entry for name, entry in entries.items() if name not in _NOT_PRINTED},
        "verdict": told.verdict(planned, area=False),
        "remarks": list(told.remarks(planned)),
        "baseline_faults": {"work": work, "job": job},
        "table": list(map(asdict, planned.table)),
        "notes": list(map(asdict, told.notes(planned))),
        "loads": list(map(asdict, told.loads(planned))),
    }


def _print_plan(planned: cmbot.Plan, *, verbose: bool) -> None:
    """Print at most ten lines of figures and five sentences, or all."""
    told = cmbot.planning
    if out.is_terminal or verbose:
        print_table(planned.scene.name, planned.headings, planned.rows(first=not verbose))
    else:
        out.print(planned.summary())
    if verbose:
        print_table("Loads", told.LOAD_HEADINGS, told.load_rows(planned))
    print_lines(told.remarks(planned) if verbose else told.first_remarks(planned))


# Reasons that are printed at the end.
_MAX_REASONS = 5


@dataclass(frozen=True, kw_only=True)
class CampaignCommand(Reporting):
    """Plan many scenes on several processes; go on where an earlier call stopped.

    Exit status 3 where a job was not planned.

    Example: cmbot campaign bridge.yaml --workers 2
    """

    file: Path = argument("A campaign file, a CSV table of jobs, or a folder of scenes.", "FILE")
    output: Path | None = option(None, "Folder to write; out/NAME if left out.", "--output", "-o")
    workers: int = option(1, "Processes on this machine.", least=1)
    scheduler: str | None = option(None, "Use the workers of this dask scheduler.", metavar="ADDRESS")
    pages: bool = option(False, "Write replay and report of every plan.")
    again: bool = option(False, "Plan those again that were not planned before.")

    def __call__(self) -> int:
        with ConsoleProgress(quiet=self.quiet) as console:

            def told(progress: cmbot.campaigns.CampaignProgress) -> None:
                # What was up to date took no time.
                done, total = progress.done - progress.resumed, progress.total - progress.resumed
                console.stage(_progress(progress), done / max(total, 1))

            try:
                done = cmbot.campaign(
                    self.file,
                    self.output,
                    workers=self.workers,
                    scheduler=self.scheduler,
                    pages=self.pages,
                    again=self.again,
                    progress=told,
                )
            except KeyboardInterrupt:
                if not self.quiet:
                    err.print("stopped; the same command goes on from here")
                raise
        failed = [row for row in done.rows if row["ended"] != "planned"]

        def data() -> dict[str, Any]:
            return {
                "directory": str(done.directory),
                "files": list(map(str, _campaign_files(done))),
                "jobs": len(done.rows),
                "ends": dict(done.ends),
                "kept": dict(done.kept),
                "failed": [{name: row[name] for name in ("name", "ended", "reason")} for row in failed],
                "seconds": done.seconds,
            }

        self.answer(data, lambda: _print_campaign(done, failed))
        return ExitStatus.NO_PLAN if failed else ExitStatus.DONE


def _campaign_files(done: cmbot.Campaign) -> tuple[Path, Path]:
    """The table of a campaign, and its page."""
    return done.directory / cmbot.campaigns.RESULTS, done.directory / cmbot.campaigns.OVERVIEW


def _progress(progress: cmbot.campaigns.CampaignProgress) -> str:
    others = [f"{number} {end}" for end, number in progress.ends.items() if end != "planned"]
    before = [f"{progress.resumed} before"] if progress.resumed else []
    return ", ".join([f"planning: {progress.done} of {progress.total}", *before, *others])


def _print_campaign(done: cmbot.Campaign, failed: Sequence[Mapping[str, Any]]) -> None:
    from cmbot.common.reading.validation import counted

    counts = ", ".join(f"{number} {end}" for end, number in done.ends.items())
    kept, kept_failures = done.kept.total(), done.kept.total() - done.kept["planned"]
    before = f", {kept} of them before" if kept else ""
    out.print(
        f"{one_line(done.name)}: {counted(len(done.rows), 'job')} in {done.seconds:.1f} s{before}: {counts}."
    )
    print_lines(f"{row['name']}: {row['ended']}: {row['reason']}" for row in failed[:_MAX_REASONS])
    if len(failed) > _MAX_REASONS:
        out.print(f"… and {len(failed) - _MAX_REASONS} more.")
    if kept_failures:
        out.print(f"{kept_failures} of these ended so before; --again plans them again.")
    table, page = map(one_line, _campaign_files(done))
    out.print(f"Table: {table}.")
    out.print(f"Look at it: open {page} in a browser.")
