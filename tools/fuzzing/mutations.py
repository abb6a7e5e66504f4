"""Mutations of text, of nested data, of XML, of NumPy archives, of plan directories and of command lines."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator
from random import Random
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cmbot.common.validation import plain
from cmbot.scene import PlannerOptions
from fuzzing.corpus import Corpus, Files, as_yaml

__all__ = ["KINDS", "Case", "make_case"]

KINDS = {"scene": 0.40, "robot": 0.26, "plan directory": 0.20, "command line": 0.138, "planning": 0.002}
"""Share of the mutants of each kind."""

_LARGEST_SCALED = 1e300
ODD_NUMBERS: tuple[float, ...] = (
    *(0, -0.0, 1, -1, 2, 3, 7, 0.5, -0.5, 360, 1e-9, 1e-3, 1e3, 1e4, 1e6, 1e9, -1e4, -1e9),
    *(5e-324, 2.3e-308, 1e-300, 1e-154, 1e-16, 1e16, 1e100, 1e154, 1e155, 1e300, 1.7976931348623157e308),
    *(2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63, 2**64, 10**30, -(10**30), 10**400),
    *(math.inf, -math.inf, math.nan),
)
ODD_TEXTS = (
    *("", " ", "x", "cmbot", "triangle", "arm.urdf", "block.obj", "nosuch", ".", "..", "/", "~", "/dev/null"),
    *("\0", "a\0b", "é", "狗", "\u2028", "\ud800", "\x1b[31m", "\n", "a\nb", "[red]", "%s", "{}", "*a", "&a"),
    *("null", "true", "yes", "1e5", ".nan", "nan", "inf", "0x10", "1_000", "2001-01-01", "1:30", "٣", "1,5"),
    *("a" * 300, "a" * 10_000, "a.b" * 50, "[" * 200, "\u200b", "\ufeff", "’", "-", "--", "#"),
)
_ODD_BYTES = (
    *(b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\x1b[31m", b"\r", b"\t", b"\n---\n", b"\n...\n", b"%YAML 1.1\n"),
    *(
        b"&a ",
        b"*a ",
        b"!!python/object ",
        b"!x ",
        b"<<: ",
        b"? ",
        b"- ",
        b": ",
        b"{",
        b"}",
        b"[",
        b"]",
        b'"',
    ),
    *(
        b"'",
        b"|\n",
        b">\n",
        b"#",
        b",",
        b"-",
        b"nan",
        b".inf",
        b"1e999",
        b"<!-- ",
        b"<![CDATA[",
        b"&amp;",
        b"&x;",
    ),
    *(
        b"<!DOCTYPE a [<!ENTITY x 'y'>]>",
        b"\xed\xa0\x80",
        b"[" * 100,
        b"[" * 5000,
        b"{a: " * 300,
        b"- " * 500,
    ),
    *(b"9" * 5000, b"x" * 70_000, b"<a>" * 2000, b"\n" * 1000, "\u2028".encode(), "\u0085".encode()),
)
_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")

Change = Callable[[Random, bytes], bytes]


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


def make_case(corpus: Corpus, seed: int, index: int) -> Case:
    """Return a campaign's mutant; the same for the same seed, index and corpus."""
    rng = Random(f"{seed}/{index}")
    (kind,) = rng.choices(list(KINDS), list(KINDS.values()))
    match kind:
        case "scene":
            return Case(kind, index, {**corpus.robot, "scene.yaml": _mutated_scene(rng, corpus)})
        case "robot":
            files, names = dict(corpus.robot), sorted(corpus.robot.keys() - {"scene.yaml", "block.obj"})
            for _ in range(_several(rng)):
                name = "arm.urdf" if rng.random() < 0.5 else rng.choice(names)
                files[name] = _mutated_file(rng, name, files[name])
            if rng.random() < 0.1:
                files[rng.choice(names)] = rng.choice((b"", rng.randbytes(200), corpus.robot["block.obj"]))
            return Case(kind, index, files)
        case "plan directory":
            return Case(kind, index, _mutated_plan(rng, corpus), verify=rng.random() < 0.03)
        case "command line":
            return _command_line(rng, corpus, index)
        case _:
            scene = as_yaml(_plannable_scene(rng, dict(corpus.scenes)["full"]))
            words = ("plan", "scene.yaml", "-o", "out", *rng.choice(((), ("--json",), ("--quiet",))))
            return Case(kind, index, {**corpus.robot, "scene.yaml": scene}, words, verify=True)


def _several(rng: Random) -> int:
    """How many mutations: mostly one."""
    return 1 + (rng.random() < 0.3) + (rng.random() < 0.1) + 3 * (rng.random() < 0.03)


def _mutated_scene(rng: Random, corpus: Corpus) -> bytes:
    # The shipped scenes take longer, and have nothing that the others lack but comments.
    (chosen,) = rng.choices(corpus.scenes, (3, 8, 1, 0.5))
    content = chosen[1]
    if isinstance(content, str):
        text = content.encode()
    else:
        data = copy.deepcopy(content)
        for _ in range(_several(rng) if rng.random() < 0.85 else 0):
            data = mutate_data(rng, data)
        text = as_yaml(data)
        if rng.random() < 0.2:
            text = json.dumps(data, indent=rng.choice((None, 1))).encode("utf-8", "surrogatepass")
        if rng.random() < 0.8:
            return text
    for _ in range(_several(rng)):
        text = mutate_text(rng, text)
    return text


def mutate_text(rng: Random, text: bytes) -> bytes:
    """Return text with one change: cut, flipped, doubled, swapped, with odd bytes or another number in it."""
    if not text:
        return rng.choice(_ODD_BYTES)
    at = rng.randrange(len(text))
    to = min(len(text), at + int(rng.expovariate(1 / 30)) + 1)
    lines = text.split(b"\n")
    k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(10):
        case 0:
            return text[:at]
        case 1:
            return text[:at] + bytes([text[at] ^ (1 << rng.randrange(8))]) + text[at + 1 :]
        case 2:
            return text[:at] + text[to:]
        case 3:
            return text[:to] + text[at:]
        case 4:
            return text[:at] + rng.choice(_ODD_BYTES) + text[at:]
        case 5 | 6:
            numbers = list(_NUMBER.finditer(text))
            if not numbers:
                return text[:at]
            start, end = rng.choice(numbers).span()
            return text[:start] + str(rng.choice(ODD_NUMBERS)).encode() + text[end:]
        case 7:
            lines[k], lines[m] = lines[m], lines[k]
        case 8:
            lines.insert(m, lines[k])
        case _:
            del lines[k]
    return b"\n".join(lines)


def mutate_data(rng: Random, data: Any) -> Any:
    """Return nested data with one change in it, anywhere."""
    places = list(_places(data))
    if not places:
        return _odd_value(rng, data)
    holder, key = rng.choice(places)
    value = holder[key]
    match rng.randrange(8):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            name = rng.choice((str(key)[:-1], f"{key}s", f"{key}_m", str(key).upper(), *ODD_TEXTS))
            holder[name] = holder.pop(key) if rng.random() < 0.7 else copy.deepcopy(value)
        case 1:
            holder.insert(key, copy.deepcopy(value))
        case 2 if isinstance(value, list):
            holder[key] = value * rng.choice((0, 2, 2, 30, 300)) if len(value) < 1000 else value[:1]
        case 3:
            other, name = rng.choice(places)
            holder[key] = copy.deepcopy(other[name])
        case 4:
            for _ in range(rng.choice((1, 1, 2, 45, 55, 150))):
                value = [value] if rng.random() < 0.5 else {"a": value}
            holder[key] = value
        case _:
            holder[key] = _odd_value(rng, value)
    return data


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    """All holders and keys in nested data; of long lists of numbers, a few."""
    stack = [data]
    while stack:
        holder = stack.pop()
        if not isinstance(holder, dict | list):
            continue
        keys = list(holder) if isinstance(holder, dict) else list(range(min(len(holder), 20)))
        for key in keys:
            yield holder, key
            stack.append(holder[key])


def _odd_value(rng: Random, value: Any) -> Any:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # What is larger could not be scaled.
    if number and abs(value) < _LARGEST_SCALED and rng.random() < 0.75:
        scaled = value * rng.choice((-1, 0.1, 0.999, 1.001, 2, 10, 57.3, 1000, 1e6, 1e-6))
        return rng.choice((*ODD_NUMBERS, scaled, scaled, scaled, int(scaled), float(value)))
    return rng.choice(
        (
            None,
            True,
            False,
            [],
            {},
            [[]],
            {"a": 1},
            rng.choice(ODD_TEXTS),
            rng.choice(ODD_TEXTS),
            rng.choice(ODD_NUMBERS),
        )
    )


def _mutated_file(rng: Random, name: str, content: bytes) -> bytes:
    """Return one of a robot's files, mutated by its structure or as text."""
    if name.endswith((".urdf", ".srdf")) and rng.random() < 0.7:
        return _by_structure(_mutate_xml, rng, content)
    if name.endswith(".stl") and rng.random() < 0.6:
        return _by_structure(_mutate_stl, rng, content)
    return mutate_text(rng, content)


def _by_structure(change: Change, rng: Random, content: bytes) -> bytes:
    """Return a file changed by its structure, or as text where that has been broken before."""
    try:
        return change(rng, content)
    except Exception:  # noqa: BLE001  broken files break their readers in many ways
        return mutate_text(rng, content)


def _mutate_stl(rng: Random, content: bytes) -> bytes:
    numbers = np.frombuffer(content[84:], dtype=np.uint8).copy()
    facet = numbers.reshape(-1, 50)[rng.randrange(len(numbers) // 50)]
    odd = rng.choice((math.nan, math.inf, 1e30, 1e-30, 0.0, 3.4e38))
    facet[: 4 * rng.randrange(1, 13)].view("<f4")[-1:] = odd
    count = rng.choice((12, 12, 12, 0, 13, 2**31, 2**32 - 1))
    return content[:80] + count.to_bytes(4, "little") + numbers.tobytes()


def _mutate_json(rng: Random, content: bytes) -> bytes:
    return json.dumps(mutate_data(rng, json.loads(content))).encode("utf-8", "surrogatepass")


def _mutate_xml(rng: Random, content: bytes) -> bytes:
    root = ElementTree.fromstring(content)
    element = rng.choice(list(root.iter()))
    parents = {child: parent for parent in root.iter() for child in parent}
    numbers = [(e, k) for e in root.iter() for k, v in e.attrib.items() if v[:1] in tuple("-0123456789")]
    match rng.randrange(9):
        case 0 if element in parents:
            parents[element].remove(element)
        case 1 if element in parents:
            parents[element].append(copy.deepcopy(element))
        case 2:
            element.tag = rng.choice(("robot", "link", "joint", "mesh", "x", "mimic", "transmission"))
        case 3 if element.attrib:
            del element.attrib[rng.choice(list(element.attrib))]
        case 4 if element.attrib:
            name = rng.choice(list(element.attrib))
            others = [e.get(name) for e in root.iter() if e.get(name)]
            texts = [text for text in ODD_TEXTS if text.isprintable()]
            element.set(name, rng.choice((rng.choice(texts), rng.choice(others))))
        case 5:
            for child in list(element):
                if rng.random() < 0.5:
                    element.remove(child)
                    rng.choice(list(root.iter())).append(child)
        case 6:
            element.text = rng.choice(("x", " ", "1 2 3"))
        case _ if numbers:
            chosen, name = rng.choice(numbers)
            words = chosen.get(name, "").split()
            words[rng.randrange(len(words))] = str(rng.choice(ODD_NUMBERS))
            chosen.set(name, " ".join(words))
    return ElementTree.tostring(root)


def _mutated_plan(rng: Random, corpus: Corpus) -> Files:
    files = dict(rng.choice(corpus.plans))
    rehash = rng.random() < 0.6
    for _ in range(_several(rng)):
        name = "plan.json" if rng.random() < 0.4 else rng.choice(sorted(files))
        content = files[name]
        if name.endswith(".npz") and rng.random() < 0.7:
            files[name] = _by_structure(_mutate_npz, rng, content)
        elif name.endswith(".json") and rng.random() < 0.8:
            files[name] = _by_structure(_mutate_json, rng, content)
        elif rng.random() < 0.05:
            del files[name]
            return files
        else:
            files[name] = mutate_text(rng, content)
    return _rehashed(files) if rehash else files


def _rehashed(files: Files) -> Files:
    """Return a plan's files with the right hashes in its JSON files, where those can be read."""
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    for name in ("plan.json", "tracking.json"):
        try:
            data = json.loads(files[name])
            data["files"] = {each: hashes[each] for each in data["files"] if each in hashes}
            files[name] = json.dumps(data).encode("utf-8", "surrogatepass")
        except (KeyError, ValueError, TypeError, RecursionError):
            continue
    return files


def _mutate_npz(rng: Random, content: bytes) -> bytes:
    arrays = dict(np.load(io.BytesIO(content)))
    name = rng.choice(sorted(arrays) or ["t"])
    array = arrays.get(name, np.zeros(3))
    file = io.BytesIO()
    match rng.randrange(9):
        case 0:
            arrays.pop(name, None)
        case 1:
            arrays[name] = array[..., : rng.randrange(1, 4)]
        case 2 if array.size:
            array.flat[rng.randrange(array.size)] = float(rng.choice(ODD_NUMBERS[:-10]))
        case 3 if array.size:
            array.flat[rng.randrange(array.size)] = rng.choice((math.nan, math.inf, -1e300))
        case 4:
            arrays[name] = array.astype(rng.choice(("f4", "i8", "c16", "U9", "O", "?", ">f8")))
        case 5:
            arrays[rng.choice(("u", "../q", "q.npy", "\0", "t" * 300))] = array
        case 6:
            np.savez_compressed(file, **{**arrays, name: np.zeros((rng.choice((10, 10**6)), 7))})
            return file.getvalue()
        case 7:
            shape = rng.choice(((10**9, 7), (-1,), (2**62, 2**62), (0,), (), (3, 0), (10**12,)))
            with zipfile.ZipFile(file, "w") as archive:
                head = str({"descr": "<f8", "fortran_order": False, "shape": shape}).encode() + b"\n"
                archive.writestr(f"{name}.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
            return file.getvalue()
        case _:
            arrays[name] = array.reshape(rng.choice(((-1,), (1, -1), (-1, 1), (1, 1, -1))))
    np.savez(file, **arrays)
    return file.getvalue()


_VERBS = ("plan", "replay", "report", "simulate", "check", "doctor", "reproduce")
_OPTIONS = {
    "plan": ("-o", "--output", "--force", "--set", "--json", "--quiet", "-q"),
    "replay": ("--html",),
    "report": ("--html", "--force"),
    "simulate": ("--damping", "--initial", "--stiffness", "--segments", "--force", "--json", "--details"),
    "check": ("--json", "--quiet"),
    "doctor": (),
    # Never runs: it takes minutes.
    "reproduce": ("--nonsense",),
}
_WITH_VALUE = ("-o", "--output", "--set", "--html", "--damping", "--initial", "--stiffness", "--segments")
_PLACES = ("scene.yaml", "arm.urdf", "plan", "out", "nosuch", "triangle", "plan/plan.json", ".", "block.obj")


def _command_line(rng: Random, corpus: Corpus, index: int) -> Case:
    files = dict(corpus.robot)
    verb = rng.choice(_VERBS) if rng.random() < 0.97 else rng.choice(("plna", "", "--version", "--help"))
    words = [verb]
    # The shipped scenes take seconds, those that planning would take.
    places = [place for place in _PLACES if not (verb == "plan" and place == "triangle")]
    if rng.random() < 0.95 and verb not in ("doctor", "reproduce"):
        words.append(rng.choice(places) if rng.random() < 0.8 else rng.choice(ODD_TEXTS))
    for _ in range(rng.randrange(4)):
        option = rng.choice(_OPTIONS.get(verb, ("--x",)) or ("--x",))
        words.append(option)
        if option in _WITH_VALUE and rng.random() < 0.97:
            words.append(_option_value(rng, option))
    if verb == "reproduce":
        words.append("--nonsense")
    if rng.random() < 0.1:
        words.insert(rng.randrange(len(words) + 1), rng.choice(ODD_TEXTS))
    # Planning by chance would take seconds; the kind "planning" plans.
    if verb == "plan" and not any(word == "--set" for word in words):
        words += ["--set", _option_value(rng, "--set")]
    if rng.random() < 0.3:
        files["scene.yaml"] = _mutated_scene(rng, corpus)
    if any(word.startswith("plan") for word in words[1:]):
        plan = corpus.plans[0] if rng.random() < 0.5 else _mutated_plan(rng, corpus)
        files |= {f"plan/{name}": content for name, content in plan.items()}
    # No word of a command line can hold a null byte.
    return Case("command line", index, files, tuple(word.replace("\0", "") for word in words))


def _option_value(rng: Random, option: str) -> str:
    number = str(rng.choice(ODD_NUMBERS))
    match option:
        case "--set":
            defaults = plain(PlannerOptions(), "fuzz")
            name = rng.choice(sorted(defaults))
            value = rng.choice((number, number, rng.choice(ODD_TEXTS), json.dumps(defaults[name]), "[1, 2]"))
            name = name if rng.random() < 0.9 else rng.choice((name[:-1], "seconds", *ODD_TEXTS))
            return f"{name}={value}" if rng.random() < 0.97 else rng.choice((name, value))
        case "-o" | "--output" | "--html":
            return rng.choice((*_PLACES, "out/a/b", "page.html", "/proc/x", "/nosuch/x", *ODD_TEXTS))
        case "--initial":
            return rng.choice(("equilibrium", "undeformed", *ODD_TEXTS))
        case _:
            return rng.choice((number, number, "1", "0.5", rng.choice(ODD_TEXTS)))


def _plannable_scene(rng: Random, scene: dict[str, Any]) -> dict[str, Any]:
    """A scene that can be planned, or nearly, with random options and a random short path."""
    scene = copy.deepcopy(scene)
    by = [round(rng.uniform(-0.1, 0.1), 3) for _ in range(3)]
    scene["posture_deg"] = [round(angle + rng.gauss(0, 20), 1) for angle in scene["posture_deg"]]
    scene["robot"] |= {
        "tool_length_m": round(rng.uniform(0.01, 0.3), 3),
        "payload_kg": rng.choice((0, 0.5, 2, 30)),
    }
    scene["tool_path"] = {
        "keep": rng.choice(("pose", "axis", "position", {"axis_within_deg": rng.choice((0.1, 10, 90))})),
        "legs": [{"by": by, "seconds": rng.choice((0.3, 2, 4, 4, 30))}],
        "via_points": rng.choice((5, 6, 8, 12)),
    }
    if isinstance(scene["tool_path"]["keep"], dict):
        scene["format"] = "cmbot-scene/2"
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
        "quiet_modes": rng.choice((0, 2, 10)),
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
        "gap_target": rng.choice((0, 2e-3, 1)),
        "max_passes": rng.choice((1, 5, 20)),
        "max_iterations": rng.choice((1, 20, 100)),
    }
    return scene
