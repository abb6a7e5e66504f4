"""What is mutated: scenes, robots, plan directories, measurements, command lines, scenes to be planned."""

from __future__ import annotations

import copy
import hashlib
import json
from random import Random
from typing import Any

from ruamel.yaml import YAML

from cmbot.common.reading.validation import plain
from cmbot.scene import PlannerOptions
from fuzzing.corpus import Corpus, Files, as_yaml
from fuzzing.mutations import (
    ODD_NUMBERS,
    ODD_TEXTS,
    by_structure,
    mutate_data,
    mutate_json,
    mutate_npz,
    mutate_text,
    mutated_file,
    several,
)

__all__ = ["KINDS", "Case", "make_case"]

KINDS = {
    "scene": 0.33,
    "robot": 0.20,
    "plan directory": 0.18,
    "measurements": 0.08,
    "campaign": 0.04,
    "walk": 0.03,
    "command line": 0.138,
    "planning": 0.002,
}
"""Share of the mutants of each kind."""


class Case:
    """One mutant: files for an empty folder, and what is done with them.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    index : int
        Which of a campaign's mutants.
    files : dict
        From names, with folders, to content.
    words : tuple of str
        Of a command line.
    verify : bool
        Whether a plan is certified again.
    """

    def __init__(
        self, kind: str, index: int, files: Files, words: tuple[str, ...] = (), *, verify: bool = False
    ) -> None:
        self.kind, self.index, self.files, self.words, self.verify = kind, index, files, words, verify

    def with_files(self, files: Files) -> Case:
        """Return the case with other files."""
        return Case(self.kind, self.index, files, self.words, verify=self.verify)


def make_case(corpus: Corpus, seed: int, only: str | None, index: int) -> Case:
    """Return a campaign's mutant, of any kind or of `only` one; the same for the same arguments."""
    rng = Random(f"{seed}/{index}")
    (kind,) = rng.choices(list(KINDS), list(KINDS.values()))
    kind = only or kind
    match kind:
        case "scene":
            return Case(kind, index, {**corpus.robot, "scene.yaml": _mutated_scene(rng, corpus)})
        case "robot":
            files, names = dict(corpus.robot), sorted(corpus.robot.keys() - {"scene.yaml", "block.obj"})
            for _ in range(several(rng)):
                name = "arm.urdf" if rng.random() < 0.5 else rng.choice(names)
                files[name] = mutated_file(rng, name, files[name])
            if rng.random() < 0.1:
                files[rng.choice(names)] = rng.choice((b"", rng.randbytes(200), corpus.robot["block.obj"]))
            return Case(kind, index, files)
        case "plan directory":
            return Case(kind, index, _mutated_plan(rng, corpus), verify=rng.random() < 0.03)
        case "measurements":
            return Case(kind, index, corpus.robot | _one_mutated(rng, corpus.measured))
        case "walk":
            change = mutate_json if rng.random() < 0.9 else mutate_text
            content = corpus.walk
            for _ in range(several(rng)):
                content = by_structure(change, rng, content)
            return Case(kind, index, {"walk.json": content})
        case "campaign":
            return Case(kind, index, corpus.robot | _one_mutated(rng, corpus.campaign))
        case "command line":
            return _command_line(rng, corpus, index)
        case _:
            scene = as_yaml(_plannable_scene(rng, dict(corpus.scenes)["full"]))
            words = ("plan", "scene.yaml", "-o", "out", *rng.choice(((), ("--json",), ("--quiet",))))
            return Case(kind, index, {**corpus.robot, "scene.yaml": scene}, words, verify=True)


def _mutated_scene(rng: Random, corpus: Corpus) -> bytes:
    # The shipped scenes take longer, and have nothing that the others lack but comments.
    weights = [1.5, 8, 2, *(0.5 if isinstance(content, str) else 1 for _, content in corpus.scenes[3:])]
    ((_, content),) = rng.choices(corpus.scenes, weights)
    return _mutated_yaml(rng, content)


def _one_mutated(rng: Random, files: Files) -> Files:
    """Return files with one of them mutated, those of data by their structure."""
    name = rng.choice(sorted(files))
    content = files[name]
    data = content.decode() if name.endswith(".csv") else YAML(typ="safe", pure=True).load(content)
    return files | {name: _mutated_yaml(rng, data)}


def _mutated_yaml(rng: Random, content: Any) -> bytes:
    """Return a file with mutations in its content: text, or data."""
    if isinstance(content, str):
        text = content.encode()
    else:
        data = copy.deepcopy(content)
        for _ in range(several(rng) if rng.random() < 0.85 else 0):
            data = mutate_data(rng, data)
        text = as_yaml(data)
        if rng.random() < 0.2:
            text = json.dumps(data, indent=rng.choice((None, 1))).encode("utf-8", "surrogatepass")
        if rng.random() < 0.8:
            return text
    for _ in range(several(rng)):
        text = mutate_text(rng, text)
    return text


def _mutated_plan(rng: Random, corpus: Corpus) -> Files:
    files = dict(rng.choice(corpus.plans))
    rehash = rng.random() < 0.6
    for _ in range(several(rng)):
        name = "plan.json" if rng.random() < 0.4 else rng.choice(sorted(files))
        content = files[name]
        if name.endswith(".npz") and rng.random() < 0.7:
            files[name] = by_structure(mutate_npz, rng, content)
        elif name.endswith(".json") and rng.random() < 0.8:
            files[name] = by_structure(mutate_json, rng, content)
        elif rng.random() < 0.05:
            del files[name]
            return files
        else:
            files[name] = mutate_text(rng, content)
    return _rehashed(files) if rehash else files


def _rehashed(files: Files) -> Files:
    """Return a plan's files with the right hashes in its plan.json, where that can be read."""
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    try:
        data = json.loads(files["plan.json"])
        data["files"] = {each: hashes[each] for each in data["files"] if each in hashes}
        data.pop("content", None)
        data["content"] = hashlib.sha256(json.dumps(data).encode()).hexdigest()
        files["plan.json"] = json.dumps(data).encode("utf-8", "surrogatepass")
    except (AttributeError, KeyError, ValueError, TypeError, RecursionError):
        return files
    return files


_OPTIONS = {
    "plan": ("-o", "--output", "--force", "--set", "--json", "--quiet", "-q"),
    "replay": ("--html",),
    "report": ("--html", "--force"),
    "compare": ("--html", "--force"),
    "export": ("--mcap", "--csv", "--work", "--ros", "--ros-package", "--force"),
    "simulate": ("--damping", "--initial", "--stiffness", "--segments", "--force", "--json", "--details"),
    "identify": (
        "-o",
        "--propose",
        "--weight",
        "--gauge",
        "--axes",
        "--job",
        "--accept-misfit",
        "--force",
        "--json",
        "-q",
    ),
    "new": (
        "--from",
        "--tool-at",
        "--rpy-deg",
        "--base",
        "--tool",
        "-o",
        "--force",
        "--json",
    ),
    "check": ("--json", "--quiet", "--write-srdf"),
    "scenes": ("--html", "--force", "--json"),
    "schema": (),
    "doctor": (),
    # Another arm than the shipped one is refused by these.
    "stand": ("-o", "--objective", "--plans", "--spacing", "--pair-spacing", "--one-foot", "--json"),
    "walk": ("-o", "--to", "--spacing", "--speed", "--json"),
    # Never runs: it takes minutes.
    "reproduce": ("--nonsense",),
}
_NUMBERS = ("--damping", "--stiffness", "--segments", "--weight", "--gauge", "--plans", "--spacing")
_NUMBERS += ("--pair-spacing", "--speed")
_FILES = (
    "-o",
    "--output",
    "--html",
    "--mcap",
    "--csv",
    "--ros",
    "--ros-package",
    "--job",
    "--from",
)
_FILES += ("--write-srdf", "--to")
_WITH_VALUE = {*_NUMBERS, *_FILES, "--set", "--initial", "--propose", "--axes", "--tool-at", "--rpy-deg"}
_WITH_VALUE |= {"--base", "--tool", "--objective"}
_WITHOUT_PLACE = ("new", "scenes", "schema", "doctor", "reproduce")
_PLACES = ("scene.yaml", "arm.urdf", "plan", "out", "nosuch", "triangle", "plan/plan.json", ".", "block.obj")


def _command_line(rng: Random, corpus: Corpus, index: int) -> Case:
    files = dict(corpus.robot)
    verb = (
        rng.choice(sorted(_OPTIONS))
        if rng.random() < 0.97
        else rng.choice(("plna", "", "--version", "--help"))
    )
    words = [verb]
    # The shipped scenes take seconds, those that planning would take.
    odd = verb in ("plan", "stand", "walk", "identify")
    places = [place for place in _PLACES if not (odd and place == "triangle")]
    odd_texts = [text for text in ODD_TEXTS if not (odd and text == "triangle")]
    if verb == "identify":
        files |= corpus.measured
        places += [*corpus.measured] * 2
    count = 0 if verb in _WITHOUT_PLACE else 2 if verb == "compare" else rng.random() < 0.95
    words += [rng.choice(places if rng.random() < 0.8 else odd_texts) for _ in range(count)]
    for _ in range(rng.randrange(4)):
        option = rng.choice(_OPTIONS.get(verb, ("--x",)) or ("--x",))
        words.append(option)
        if option in _WITH_VALUE and rng.random() < 0.97:
            words += _option_values(rng, option)
    if verb == "reproduce":
        words.append("--nonsense")
    if rng.random() < 0.1:
        words.insert(rng.randrange(len(words) + 1), rng.choice(ODD_TEXTS))
    # Planning by chance would take seconds; the kind "planning" plans.
    if verb == "plan" and not any(word == "--set" for word in words):
        words += ["--set", *_option_values(rng, "--set")]
    if rng.random() < 0.3:
        files["scene.yaml"] = _mutated_scene(rng, corpus)
    if any(word.startswith("plan") for word in words[1:]):
        plan = corpus.plans[0] if rng.random() < 0.5 else _mutated_plan(rng, corpus)
        files |= {f"plan/{name}": content for name, content in plan.items()}
    # No word of a command line can hold a null byte.
    return Case("command line", index, files, tuple(word.replace("\0", "") for word in words))


def _option_values(rng: Random, option: str) -> list[str]:
    if option in ("--tool-at", "--rpy-deg") and rng.random() < 0.97:
        return [str(rng.choice((0.3, 0.1, -0.2, 0.4, rng.choice(ODD_NUMBERS)))) for _ in range(3)]
    return [_option_value(rng, option)]


def _option_value(rng: Random, option: str) -> str:
    number = str(rng.choice(ODD_NUMBERS))
    if option in _FILES:
        return rng.choice((*_PLACES, "out/a/b", "page.html", "/proc/x", "/nosuch/x", *ODD_TEXTS))
    match option:
        case "--set":
            defaults = plain(PlannerOptions(), "fuzz")
            name = rng.choice(sorted(defaults))
            value = rng.choice((number, number, rng.choice(ODD_TEXTS), json.dumps(defaults[name]), "[1, 2]"))
            name = name if rng.random() < 0.9 else rng.choice((name[:-1], "seconds", *ODD_TEXTS))
            return f"{name}={value}" if rng.random() < 0.97 else rng.choice((name, value))
        case "--initial":
            return rng.choice(("equilibrium", "undeformed", *ODD_TEXTS))
        case "--propose":
            return rng.choice(("0", "1", "2", "101", "-1", "2.5", *ODD_TEXTS))
        case "--axes":
            return rng.choice(("x", "z", "zyx", "xx", "w", *ODD_TEXTS))
        case "--base" | "--tool" | "--objective":
            return rng.choice(("base", "tool", "link_3", "torque", "hold", *ODD_TEXTS))
        case _:
            return rng.choice((number, number, "1", "0.5", rng.choice(ODD_TEXTS)))


def _plannable_scene(rng: Random, scene: dict[str, Any]) -> dict[str, Any]:
    """A scene that can be planned, or nearly, with random options and a random short path."""
    scene = copy.deepcopy(scene)
    by = [round(rng.uniform(-0.1, 0.1), 3) for _ in range(3)]
    posture = [round(angle + rng.gauss(0, 20), 1) for angle in scene["start"]["posture_deg"]]
    scene["start"] = {"posture_deg": posture}
    scene["robot"] |= {
        "tool_length_m": round(rng.uniform(0.01, 0.3), 3),
        "payload_kg": rng.choice((0, 0.5, 2, 30)),
    }
    scene["tool_path"] = {
        "keep": rng.choice(("pose", "axis", "position", {"axis_within_deg": rng.choice((0.1, 10, 90))})),
        "legs": [{"by": by, "seconds": rng.choice((0.3, 2, 4, 4, 30))}],
        "via_points": rng.choice((5, 6, 8, 12)),
    }
    for obstacle in scene["obstacles"]:
        obstacle["xyz"] = [round(rng.uniform(-1, 1), 2) for _ in range(3)]
    if rng.random() < 0.5:
        del scene["obstacles"]
    scene["guardrail"]["bays"] = rng.choice((0, 0, 1, 2))
    if scene["guardrail"]["bays"] < 2:
        scene["guardrail"] = {"bays": scene["guardrail"]["bays"]}
    scene["planner"] = {
        "knots": rng.choice(("fixed", "sliding")),
        "start": rng.choice(("free", "pinned")),
        "objective": rng.choice(("torque", "torque", "sag")),
        "moment_about": rng.choice(("foot", "base")),
        "axis_weights": rng.choice(([1, 1, 1], [1, 0, 0], [0, 0, 1], [1e6, 1e-6, 0])),
        "compensate": rng.random() < 0.2,
        "avoidance": rng.choice(("smooth", "switch")),
        "avoidance_distance_m": rng.choice((0.05, 0.15, 1.0)),
        "damping_max": rng.choice((0, 0.5, 5)),
        "path_step_s": rng.choice((0.02, 0.1)),
        "other_starts": rng.choice((0, 3)),
        "chart_spacing": rng.choice((0.3, 0.5)),
        "chart_seeds": rng.choice((1, 20)),
        "step_share": rng.choice((0.1, 0.6, 1)),
        "safety_margin_m": rng.choice((0, 0.02, 0.3)),
        "max_tool_deviation_m": rng.choice((1e-5, 1e-3, 0.1)),
        "solver": rng.choice(("auto", "sqp", "slsqp")),
        "samples_per_segment": rng.choice((4, 20)),
        "smoothing_weight": rng.choice((1e-6, 0.1, 100)),
        "peak_tolerance": rng.choice((1e-6, 1e-4, 0.1)),
        "least_peak_tolerance": rng.choice((1e-6, 2e-3, 0.1)),
        "min_gain": rng.choice((0, 2e-3, 1)),
        "max_passes": rng.choice((1, 5, 20)),
        "max_iterations": rng.choice((1, 20, 100)),
    }
    return scene
