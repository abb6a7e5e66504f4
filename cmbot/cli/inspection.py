"""The commands that inspect files and what is installed: `check`, `verify`, `scenes`, `schema`, `doctor`."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import cmbot
from cmbot.cli.command import Command, Reporting, Writing, argument, option, require_new
from cmbot.cli.completion import complete_scene
from cmbot.cli.console import ExitStatus, out, print_lines, print_pairs, print_table
from cmbot.cli.creation import PACKAGE_DIR_HELP, named_values, require_folders
from cmbot.cli.planning import finding_in_words, loaded_scene
from cmbot.common.errors import InputError, MissingExtra, SceneError, one_line
from cmbot.common.installation import install_command, model_folder, scene_folder, shipped_scenes
from cmbot.common.reading.input_files import is_file
from cmbot.version import __version__

if TYPE_CHECKING:
    from cmbot.robot import Finding

_ROBOT_SUFFIXES = (".urdf", ".xml", ".xacro")
_SCENE_SUFFIXES = (".yaml", ".yml", ".json")
# Required packages, and the modules of those that are called otherwise.
_REQUIRED_PACKAGES = (
    *("pin", "coal", "numpy", "scipy", "annotated-types", "pydantic", "ruamel.yaml", "meshcat", "yourdfpy"),
    *("u-msgpack-python", "trimesh", "fast-simplification", "threadpoolctl", "rich"),
)
_MODULE_NAMES = {"pin": "pinocchio", "u-msgpack-python": "umsgpack"}
# Programs that `cmbot replay --video` needs: the names that they have, and what installs them.
_VIDEO_PROGRAMS = (
    ("chromium", ("chromium", "chromium-browser", "google-chrome"), "apt-get install chromium"),
    ("chromedriver", ("chromedriver",), "apt-get install chromium-driver"),
    ("ffmpeg", ("ffmpeg",), "apt-get install ffmpeg"),
)
_OPTIONAL_PACKAGES = (
    ("piqp", "fast"),
    ("matplotlib", "plots"),
    ("selenium", "video"),
    ("example-robot-data", "robots"),
    ("xacrodoc", "xacro"),
    ("distributed", "campaign"),
    ("shapely", "surfaces"),
    ("mcap-ros2-support", "ros"),
    ("mujoco", "verify"),
    ("hypothesis", "test"),
)


@dataclass(frozen=True, kw_only=True)
class CheckCommand(Reporting):
    """Inspect a URDF or a scene before anything is planned with it.

    Examples: cmbot check arm.urdf, cmbot check triangle, cmbot check panda --write-srdf panda.srdf
    """

    file: str = argument(
        "A URDF, a scene file, or a shipped scene's or a robot's name.", "FILE", complete=complete_scene
    )
    write_srdf: Path | None = option(
        None, "Write an SRDF: which links of a URDF need not be checked against each other.", metavar="FILE"
    )
    xacro: tuple[str, ...] = option((), "An argument of the xacro file; repeatable.", metavar="NAME=VALUE")
    package_dir: tuple[Path, ...] = option((), PACKAGE_DIR_HELP, metavar="DIR")
    changes: tuple[str, ...] = option(
        (), "Of a scene, as of cmbot plan; repeatable.", "--set", metavar="NAME=VALUE"
    )

    def __call__(self) -> int:
        file, is_urdf = self.file, _is_robot(self.file)
        if self.changes and is_urdf:
            raise InputError("--set", "", "a URDF to check", "a scene to check")
        foreign = {"xacro": named_values(self.xacro), "package_dirs": self.package_dir}
        for name, flag in (("xacro", "--xacro"), ("package_dirs", "--package-dir")):
            if foreign[name] and not is_urdf:
                expected = f"robot.{name} in the scene, or a URDF to check"
                raise InputError(flag, "", "a scene to check", expected)
        require_folders(self.package_dir)
        if is_urdf:
            findings, found, conclusion = _check_urdf(file, foreign, advise=self.write_srdf is None)
        else:
            findings, found, conclusion = _check_scene(file, self.changes)
        if self.write_srdf is not None:
            _require_new(self.write_srdf, is_urdf)
        usable = not _errors(findings)
        if usable and self.write_srdf is not None:
            found["SRDF written"] = _write_srdf(file, self.write_srdf, foreign)
        for finding, number in () if self.json else _counted(findings):
            if finding.severity == "error" or not self.quiet:
                out.print(f"{finding_in_words(file, finding)}{f' ({number} times)' if number > 1 else ''}")

        def data() -> dict[str, object]:
            kind, told = "urdf" if is_urdf else "scene", [asdict(finding) for finding in findings]
            return {"file": file, "kind": kind, "usable": usable, "findings": told, "found": found}

        def say() -> None:
            print_pairs(found)
            out.print(conclusion)

        self.answer(data, say)
        return ExitStatus.DONE if usable else ExitStatus.BAD_INPUT


def _counted(findings: Sequence[Finding]) -> Iterator[tuple[Finding, int]]:
    """Yield findings; warnings that differ in their links or joints alone as the first, with their number."""
    alike: dict[tuple[str, ...], list[Finding]] = {}
    for k, finding in enumerate(findings):
        single = str(k) if finding.severity == "error" else ""
        key = (finding.severity, re.sub(r"\[[^]]*\]", "", finding.key), finding.got, finding.expected, single)
        alike.setdefault(key, []).append(finding)
    for each in alike.values():
        yield each[0], len(each)


def _is_robot(file: str) -> bool:
    """Whether it is a URDF, by its ending, or the name of a robot and of no file or shipped scene."""
    from cmbot.common.robot_library import library_robots

    if Path(file).suffix.lower() in _ROBOT_SUFFIXES:
        return True
    # Path.exists raises for names that no file can have.
    if is_file(file) or is_file(scene_folder() / f"{file}.yaml"):
        return False
    return file == "cmbot" or file in (library_robots() or ())


def _require_new(path: Path, is_urdf: bool) -> None:
    if not is_urdf:
        raise InputError("--write-srdf", "", "a scene to check", "a URDF to check, or the name of a robot")
    if path.exists():
        raise InputError("--write-srdf", "", f"{path}, which is there", "the path of a new file")


def _write_srdf(file: str, path: Path, foreign: Mapping[str, Any]) -> str:
    from xml.etree import ElementTree

    text = cmbot.robot.srdf_text(cmbot.robot.robot_files(file, **foreign))
    cmbot.archive.write_file(path, text.encode())
    reasons = [pair.get("reason", "") for pair in ElementTree.fromstring(text)]
    numbers = ", ".join(f"{reasons.count(reason)} {reason}" for reason in ("Adjacent", "Always", "Never"))
    return f"{path}: {len(reasons)} pairs of links ({numbers})"


def _check_urdf(
    file: str, foreign: Mapping[str, Any], *, advise: bool
) -> tuple[Sequence[Finding], dict[str, str], str]:
    """Findings, what is in the file, and the conclusion, which may advise to write an SRDF."""
    from cmbot.common.reading.validation import counted

    files, robot, found = cmbot.robot.robot_files(file, **foreign), cmbot.robot, {}
    root, findings = robot.inspect_robot(files)
    if not _errors(findings):
        found = dict(robot.overview(files, root))
        findings = sorted([*findings, *robot.inspect_loaded(files)], key=lambda finding: finding.severity)
    errors = _errors(findings)
    conclusion = f"Not usable: {counted(errors, 'error')}" if errors else "OK: no error"
    conclusion += f", {counted(len(findings) - errors, 'warning')}."
    if advise and files.srdf is None and not errors:
        conclusion += f" cmbot check {one_line(file)} --write-srdf FILE writes an SRDF."
    return findings, found, conclusion


def _check_scene(file: str, changes: Sequence[str]) -> tuple[Sequence[Finding], dict[str, str], str]:
    from cmbot.common.reading.validation import counted

    try:
        scene, options = loaded_scene(file, changes) if changes else (cmbot.load_scene(file), None)
    except SceneError as error:
        if not (error.key or is_file(file) or Path(file).suffix):
            raise _no_name(file, error) from error
        if error.key or Path(file).suffix.lower() in _SCENE_SUFFIXES or not is_file(file):
            raise
        # Nothing in it could be read as a scene's.
        expected = "a URDF (.urdf, .xml, .xacro) or a scene file (.yaml, .yml, .json)"
        raise InputError(file, "", f"a file that is neither ({error.got})", expected) from error
    if options is not None:
        scene = scene.with_options(options)
    precheck = cmbot.planning.precheck_scene(scene)
    if scene.excitation is not None or scene.damper is not None:
        cmbot.excitation.require_inputs(scene, cmbot.planning.robot_of(scene))
    errors = _errors(precheck.warnings)
    warnings, plan = len(precheck.warnings) - errors, f"cmbot plan {one_line(file)}"
    conclusion = (
        "No warning. Checked: the start, and places along the path, each for a posture that is within the "
        f"joint ranges, clear and strong enough. Not checked: the way from one to the next; {plan} finds out."
    )
    if warnings:
        them = "it" if warnings == 1 else "them"
        conclusion = f"{counted(warnings, 'warning')}; {plan} would have to deal with {them}."
    if errors:
        conclusion = f"No plan is possible: {counted(errors, 'error')}, {counted(warnings, 'warning')}."
    return precheck.warnings, dict(precheck.found), conclusion


def _no_name(file: str, error: SceneError) -> InputError:
    """The error for what is no file and no name that is known."""
    from cmbot.common.reading.validation import hint
    from cmbot.common.robot_library import LIBRARY_EXTRA, library_robots

    robots = library_robots()
    known = ("cmbot", *sorted(robots or ()))
    _, asks, tip = error.expected.partition("; did you mean")
    robot = "a robot" if robots else f"a robot (of the extra {LIBRARY_EXTRA})"
    expected = f"a URDF, a scene file, or the name of {robot} or a shipped scene"
    choices = (*shipped_scenes(), *known)
    return InputError(
        error.source,
        error.key,
        error.got,
        f"{expected}{asks}{tip}" if asks else f"{expected}{hint(file, known)}",
        choices,
    )


def _errors(findings: Sequence[Finding]) -> int:
    return sum(finding.severity == "error" for finding in findings)


@dataclass(frozen=True, kw_only=True)
class VerifyCommand(Reporting):
    """Certify what is in a folder anew, and compute it a second time by other means.

    Exit status 2, and one line that says what is wrong, where a promise is broken, two computations differ, a
    file beside the plan has another motion, or the folder is not what was asked for.

    Examples: cmbot verify out/triangle --scene triangle --set start=pinned, cmbot verify out/walk
    --scene here.yaml --to there.yaml
    """

    directory: Path = argument("The folder of a plan, a walk or a tour.", "DIR")
    scenes: tuple[str, ...] = option(
        (),
        "What was asked for: a scene file, or the name of a shipped scene; of a tour all. Left out: what the "
        "folder says.",
        "--scene",
        metavar="SCENE",
    )
    changes: tuple[str, ...] = option(
        (),
        "What was asked in place of the scene's own: a planner option, or a value by its key; repeatable.",
        "--set",
        metavar="NAME=VALUE",
    )
    to: Path | None = option(None, "Where a walk was to end: a scene, or a file with foot_1 and foot_2.")
    speed: float = option(0.03, "Metres a second of a walking foot at most, as asked.", least=1e-3, most=1.0)
    engine: Literal["mujoco"] | None = option(
        None,
        "The second engine that has to be asked: mujoco, of the extra verify. Left out: if installed.",
    )

    def __call__(self) -> None:
        from cmbot.planning.verification import engine
        from cmbot.stances.walking import load_goal

        if self.engine is not None:
            engine.require_installed()
        if self.changes and len(self.scenes) != 1:
            raise InputError("--set", "", f"{len(self.scenes)} of --scene", "one, whose values it changes")
        loaded = [loaded_scene(scene, self.changes) for scene in self.scenes]
        question = cmbot.archive.Asked(
            scenes=tuple(scene for scene, _ in loaded),
            options=loaded[0][1] if self.changes else None,
            goal=None if self.to is None else load_goal(self.to),
            foot_speed=self.speed,
        )
        verdict = cmbot.archive.verified_motions(self.directory, question)
        asked, name = engine.is_installed(), engine.ENGINE

        def data() -> dict[str, Any]:
            return {
                "directory": str(self.directory),
                "scenes": list(self.scenes),
                "engine": name if asked else None,
                **{name: value for name, value in vars(verdict).items() if name != "motions"},
                "motions": [
                    {name: value for name, value in asdict(motion).items() if name != "seconds"}
                    for motion in verdict.motions
                ],
            }

        def say() -> None:
            told = "Judged by what the folder says that was asked: --scene SCENE names the scene. It has"
            print_lines([] if self.scenes else [f"{told} {'; '.join(verdict.taken) or 'defaults'}."])
            rows = [
                (each.part, each.name, f"{each.seconds:.1f}", str(len(each.checks)))
                for each in verdict.motions
            ]
            print_table("Verified", ("part", "motion", "seconds", "checks that hold"), rows, text_columns=2)
            second = f"The second engine, {name}, was asked."
            missing = f"The second engine was not asked: {MissingExtra(name, 'verify')}."
            if others := "; ".join(verdict.other_options):
                print_lines([f"Options other than asked, as the folder states them: {others}."])
            out.print("Certified anew, and computed a second time at 300 states of each motion.")
            print_lines([f"Files that agree: {', '.join(verdict.compared)}."] * bool(verdict.compared))
            print_lines(["Not verified:", *(f"- {each}" for each in verdict.not_verified or ["nothing"])])
            out.print(second if asked else missing)

        if not self.json:
            looser = "Promised otherwise than the scene in the folder asks"
            print_lines(f"{looser}: {text}." for text in verdict.looser)
        self.answer(data, say)


@dataclass(frozen=True, kw_only=True)
class ScenesCommand(Writing):
    """List the shipped scenes, each with what it is about.

    Examples: cmbot scenes, cmbot scenes --html scenes.html
    """

    reads = False

    html: Path | None = option(None, "Page to write instead, with a picture of each scene.")

    def __call__(self) -> None:
        shown = {name: _about(name) for name in shipped_scenes()}
        if self.html is not None:
            require_new(self.html, self.force)
            cmbot.views.write_page(self.html, cmbot.views.gallery_page(shown))
            self.wrote(self.html)
            return
        about = {name: sentence for name, (sentence, _) in shown.items()}
        others = [command for name, (_, command) in shown.items() if command != f"cmbot plan {name}"]

        def say() -> None:
            print_pairs(about)
            out.print(f"{', '.join(['cmbot plan NAME', *others])}; cmbot doctor says where their files are.")

        self.answer(lambda: {"folder": str(scene_folder()), "scenes": about}, say)


def _about(name: str) -> tuple[str, str]:
    """Return the first sentence of a scene file's comments, and the command for it, if they name one."""
    lines = (scene_folder() / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    comments = takewhile(lambda line: line.startswith("# "), lines)
    words = " ".join(line[2:] for line in comments if "yaml-language-server" not in line)
    command = re.search(r"`(cmbot [^`]+)`", words)
    return words.partition(". ")[0].rstrip(".") + ".", command[1] if command else f"cmbot plan {name}"


@dataclass(frozen=True, kw_only=True)
class SchemaCommand(Command):
    """Print the JSON Schema of scene files, for editors and programs, or that of what --json prints.

    Examples: cmbot schema > scene.schema.json, cmbot schema --summary > summary.schema.json
    """

    reads = False

    summary: bool = option(False, "The schema of what commands print with --json instead.")

    def __call__(self) -> None:
        name = "summary.schema.json" if self.summary else "scene.schema.json"
        out.print((scene_folder() / name).read_text(encoding="utf-8"), end="")


@dataclass(frozen=True, kw_only=True)
class DoctorCommand(Reporting):
    """Show versions, where things were loaded from, and what is missing.

    Example: cmbot doctor
    """

    reads = False

    def __call__(self) -> int:
        symptoms = examine()
        width = max(len(symptom.name) for symptom in symptoms)

        def say() -> None:
            for symptom in symptoms:
                mark = "ok     " if symptom.healthy else "MISSING"
                out.print(f"{mark} {symptom.name:<{width}}  {one_line(symptom.found)}")

        self.answer(lambda: {"symptoms": [symptom._asdict() for symptom in symptoms]}, say)
        return ExitStatus.DONE if all(symptom.healthy for symptom in symptoms) else ExitStatus.FAILED


class Symptom(NamedTuple):
    """One line of the examination; not healthy: cmbot needs it and it is missing."""

    name: str
    found: str
    healthy: bool = True


def examine() -> list[Symptom]:
    """Return versions and places of all that cmbot uses."""
    import platform

    symptoms = [
        Symptom("cmbot", f"{__version__} from {Path(__file__).parent.parent}"),
        Symptom("python", f"{platform.python_version()} on {platform.platform()}"),
        *(_package(name, _MODULE_NAMES.get(name, name.replace("-", "_"))) for name in _REQUIRED_PACKAGES),
    ]
    for name, extra in _OPTIONAL_PACKAGES:
        version = _version(name)
        missing = f"not installed (optional: {install_command(extra)})"
        symptoms.append(Symptom(name, missing if version is None else f"{version}, of the extra {extra}"))
    for name, path in (
        ("model", model_folder() / "urdf" / "cmbot.urdf"),
        ("meshes", model_folder() / "meshes"),
        ("scenes", scene_folder() / "triangle.yaml"),
    ):
        found = str(path) if path.exists() else f"missing: {path}"
        symptoms.append(Symptom(name, found, healthy=path.exists()))
    for name, programs, command in _VIDEO_PROGRAMS:
        missing = f"not found (optional, for cmbot replay --video: {command})"
        symptoms.append(Symptom(name, next(filter(None, map(shutil.which, programs)), missing)))
    return symptoms


def _package(name: str, module: str) -> Symptom:
    from importlib import util

    try:
        spec = util.find_spec(module)
    except ModuleNotFoundError:  # the package around it is missing
        spec = None
    version = _version(name)
    if version is None or spec is None:
        return Symptom(name, f"not installed (run: pip install {name})", healthy=False)
    return Symptom(name, f"{version} from {Path(spec.origin or '').parent}")


def _version(name: str) -> str | None:
    # Its import takes as long as that of half the command line.
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
