"""Forged folders, as somebody makes them who knows the formats and keeps every hash right."""

from __future__ import annotations

import copy
import csv
import io
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from command_line import Outcome, run
from plan_folders import edit, rewrite
from scipy.interpolate import make_interp_spline
from walks import tour_record

import cmbot
from cmbot.archive import TOUR_FILE, write_results
from cmbot.collision import Clearances
from cmbot.planning import Job, QuinticTrajectory, certify, certify_move
from forged.judge import faults, tour_faults, walk_faults
from forged.scenes import ASKED, BASES, DOUBLED, FURTHER, GOAL, SMALL, Data, changed

__all__ = ["FORGERIES", "Forgery", "forged", "planned"]

Make = Callable[[Path], None]
Motion = Callable[[QuinticTrajectory], QuinticTrajectory]


@dataclass(frozen=True, kw_only=True)
class Forgery:
    """What is done to the plan of a base, which scene is asked for, and what beside the folder is forged."""

    name: str
    category: str
    base: str
    make: Make

    def __str__(self) -> str:
        return f"{self.category}: {self.name}"


def planned(data: Data, folder: Path) -> Path:
    """Plan a scene into `folder`, and return its file beside it."""
    file = _written(data, folder.with_suffix(".yaml"))
    if not (folder / "plan.json").is_file():
        outcome = run("plan", file, "-o", folder, "--force", "-q")
        if outcome.status:
            raise RuntimeError(outcome.err)
    return file


def forged(forgery: Forgery, output: Path) -> tuple[list[str], Outcome, Outcome]:
    """Forge a folder; return what is wrong by the oracles, how it is judged, and how that without a scene."""
    asked, folder = output / "asked", output / "forged" / "plan"
    base = output / "bases" / forgery.base
    shutil.rmtree(folder, ignore_errors=True)
    scene, goal = _written(ASKED[forgery.base], asked / f"{forgery.base}.yaml"), asked / "goal.yaml"
    if forgery.base in ("walk", "tour"):
        walked = base / "walk_1" if forgery.base == "tour" else base
        if not walked.is_dir():
            run("walk", scene, "--to", _written(GOAL, goal), "-o", walked, "-q")
        if forgery.base == "tour" and not (base / "tour.json").is_file():
            planned(ASKED["tour"], base / "work_1")
            parts = {"work_1": cmbot.load_plan(base / "work_1"), "walk_1": cmbot.load_walk(walked)}
            write_results(base, TOUR_FILE, tour_record(parts), {})
    elif forgery.base in BASES:
        planned(BASES[forgery.base], base)
    if base.is_dir():
        shutil.copytree(base, folder)
    forgery.make(folder)
    judges = {"walk": walk_faults, "tour": tour_faults}
    judge, more = judges.get(forgery.base), ("--to", goal) if forgery.base == "walk" else ()
    wrong = faults(scene, folder) if judge is None else judge(scene, goal, folder)
    return wrong, run("verify", folder, "--scene", scene, *more), run("verify", folder)


def _written(data: Data, file: Path) -> Path:
    """Write YAML without anchors."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(json.loads(json.dumps(data))), encoding="utf-8")
    return file


def told(**values: Any) -> Make:
    """Change ``plan.json``: values, or functions of what is there, by keys whose dots are ``__``."""

    def change(data: dict[str, Any]) -> None:
        for key, value in values.items():
            at: Any = data
            *path, last = (int(name) if name.isdigit() else name for name in key.split("__"))
            for name in path:
                at = at[name]
            at[last] = value(at[last]) if callable(value) else value

    return lambda folder: edit(folder, change)


def moved(motion: Motion, segment: str = "work") -> Make:
    """Another motion in place of a segment's, with tables that fit it."""

    def make(folder: Path) -> None:
        plan = cmbot.load_plan(folder)
        segments, begin = [], 0.0
        for each in plan.job.segments:
            x = motion(each.trajectory) if each.name == segment else each.trajectory
            segments.append(replace(each, trajectory=x, begin=begin))
            begin += float(x.t[-1])
        job = Job(segments=tuple(segments))
        cmbot.save(replace(plan, job=job), folder, force=True)
        start = np.degrees(job.strokes[0].trajectory.q[0]).tolist()
        told(start__posture_deg=start)(folder)

    return make


def other(base: str, changes: Mapping[str, Any], *, keep: tuple[str, ...] = ("options",)) -> Make:
    """The plan of another scene, said to be of this one; `keep` is what stays of its own promises."""

    def make(folder: Path) -> None:
        asked = cmbot.load_scene(ASKED[base])
        with tempfile.TemporaryDirectory() as room:
            there = Path(room) / "plan"
            planned(changed(ASKED[base], changes), there)
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(there, folder)

        def restore(data: dict[str, Any]) -> None:
            data["scene"], data["hashes"]["scene"] = asked.as_data(), asked.content_hash
            if "options" not in keep:
                data["options"] |= {
                    key: value for key, value in data["scene"]["planner"].items() if value != "auto"
                }

        edit(folder, restore)

    return make


def table(
    change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]],
    name: str = "job.csv",
    listed: str = "plan.json",
) -> Make:
    """Other rows in a table."""

    def make(folder: Path) -> None:
        rows = [*csv.DictReader((folder / name).read_text(encoding="utf-8").splitlines())]
        changed_rows, text = change(rows), io.StringIO()
        writer = csv.DictWriter(text, changed_rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(changed_rows)
        rewrite(folder, name, text.getvalue().encode(), listed)

    return make


def column(name: str, change: Callable[[float, int], float], file: str = "job.csv") -> Make:
    """Another column in a table, from its values and rows."""
    return table(
        lambda rows: [{**row, name: repr(change(float(row[name]), k))} for k, row in enumerate(rows)], file
    )


def exported(change: Callable[[dict[str, Any]], object]) -> Make:
    """A message for ROS beside the plan, with another content."""

    def make(folder: Path) -> None:
        run("export", folder, "--ros", folder / "job.json")
        data = json.loads((folder / "job.json").read_text(encoding="utf-8"))
        change(data)
        (folder / "job.json").write_text(json.dumps(data), encoding="utf-8")

    return make


def part(name: str) -> Make:
    """What is there, as what a writer left: cmbot reads it, who takes files by their names does not."""
    return lambda folder: folder.joinpath(f".{name}.part").write_bytes((folder / name).read_bytes())


def remade(base: str, changes: Data) -> Make:
    """The motion of another scene, with all that cmbot finds of it in the scene that was asked for."""

    def make(folder: Path) -> None:
        asked = cmbot.load_plan(folder)
        with tempfile.TemporaryDirectory() as room:
            planned(changed(ASKED[base], changes), Path(room) / "plan")
            others = cmbot.load_plan(Path(room) / "plan").job.segments
        robot, before = asked.robot, np.array(asked.scene.posture)
        common = (Clearances(robot, asked.scene.all_obstacles), asked.options)
        segments = []
        for mine, other in zip(asked.job.segments, others, strict=True):
            x = other.trajectory
            if mine.kind == "stroke":
                number = asked.scene.strokes[0].via_points
                found = certify(robot, mine.task, x, *common, via_points=number, start=None, sag=asked.sag)
            else:
                found = certify_move(robot, mine.task, x, *common, before, x.q[-1])
            # What is broken is not told.
            found = replace(found, checks=mine.certificate.checks)
            segments.append(replace(mine, trajectory=x, begin=other.begin, certificate=found))
        first, peak = segments[-1].trajectory.q[0], segments[-1].figures.peak_guardrail_torque
        away = float(np.abs(robot.metric.coordinates(first - before)).max())
        start = replace(asked.start, posture=first, moved=away)
        goal = replace(asked.objective, planned_peak=peak, floor=None)
        own = {"start": start, "objective": goal, "lower_bound": None, "choice": None}
        cmbot.save(replace(asked, job=Job(segments=tuple(segments)), **own), folder, force=True)

    return make


def all_of(*parts: Make) -> Make:
    def make(folder: Path) -> None:
        for part in parts:
            part(folder)

    return make


# Motions.


def bump(x: QuinticTrajectory, joint: int, size: float, knots: slice = slice(3, -3)) -> QuinticTrajectory:
    q = x.q.copy()
    q[knots, joint] += size
    return replace(x, q=q)


def offset(x: QuinticTrajectory, joint: int, size: float) -> QuinticTrajectory:
    q = x.q.copy()
    q[:, joint] += size
    return replace(x, q=q)


def warped(x: QuinticTrajectory) -> QuinticTrajectory:
    """The right way, ahead of time in its middle and on time at its ends."""
    T, u = x.t[-1], np.linspace(0, 1, 60)
    s, ds = u + 0.15 * np.sin(np.pi * u) ** 2, 1 + 0.15 * np.pi * np.sin(2 * np.pi * u)
    dds = 0.3 * np.pi**2 * np.cos(2 * np.pi * u)
    q, v, a = x.states(T * s)
    return QuinticTrajectory(t=T * u, q=q, v=v * ds[:, None], a=a * ds[:, None] ** 2 + v * dds[:, None] / T)


def stretched(x: QuinticTrajectory, factor: float) -> QuinticTrajectory:
    return QuinticTrajectory(t=x.t * factor, q=x.q, v=x.v / factor, a=x.a / factor**2)


def trembling(x: QuinticTrajectory) -> QuinticTrajectory:
    t = np.linspace(0, x.t[-1], 800)
    q, v, a = x.states(t)
    w, size = 2 * np.pi * 45 / x.t[-1], 4e-4
    wave = np.stack([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)]) * size
    hull = np.minimum(1, np.minimum(t, t[-1] - t) / 0.2) ** 3
    for part, more in zip((q, v, a), wave, strict=True):
        part[:, 6] += hull * more
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def rates(x: QuinticTrajectory, name: str, knot: int, value: float) -> QuinticTrajectory:
    array = getattr(x, name).copy()
    array[knot] += value
    return replace(x, **{name: array})


def straight(x: QuinticTrajectory, seconds: float) -> QuinticTrajectory:
    """From end to end in a line of joints."""
    u = np.linspace(0, 1, 9)
    s, ds = 10 * u**3 - 15 * u**4 + 6 * u**5, 30 * u**2 * (1 - u) ** 2
    dds = 60 * u - 180 * u**2 + 120 * u**3
    way = x.q[-1] - x.q[0]
    return QuinticTrajectory(
        t=u * seconds,
        q=x.q[0] + s[:, None] * way,
        v=ds[:, None] * way / seconds,
        a=dds[:, None] * way / seconds**2,
    )


def at_once(x: QuinticTrajectory, ramp: float = 0.4) -> QuinticTrajectory:
    """A free move that stands at its end in place of its beginning."""
    goes = x.t > ramp + 1e-9
    t = np.concatenate([[0.0], x.t[goes] - ramp, [x.t[-1]]])
    q, v, a = (np.vstack([part[:1], part[goes], part[-1:]]) for part in (x.q, x.v, x.a))
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def detour(x: QuinticTrajectory, joint: int, size: float) -> QuinticTrajectory:
    """A free move by way of elsewhere, slowly."""
    u = np.linspace(0, 1, len(x.t))
    q = x.q.copy()
    q[:, joint] += size * (u * (1 - u)) ** 3 * 64
    seconds = 30.0
    t = u * seconds
    v, a = np.gradient(q, t, axis=0), np.zeros_like(q)
    v[[0, -1]] = 0.0
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def _knots(change: Callable[[dict[str, Any]], None]) -> Make:
    """The knots of the job alone: neither table nor figures."""

    def make(folder: Path) -> None:
        with np.load(folder / "job.npz") as file:
            arrays = {name: file[name].copy() for name in file.files}
        change(arrays)
        content = io.BytesIO()
        np.savez(content, **arrays)
        rewrite(folder, "job.npz", content.getvalue())

    return make


def _half(arrays: dict[str, Any]) -> None:
    """Twice as quick."""
    for name, factor in (("t", 0.5), ("v", 2.0), ("a", 4.0)):
        arrays[name] = factor * arrays[name]


def _after_the_end(arrays: dict[str, Any]) -> None:
    """The arm goes on when its job is done."""
    arrays["t"] = np.append(arrays["t"], arrays["t"][-1] + 3.0)
    for name in "qva":
        arrays[name] = np.vstack([arrays[name], arrays[name][-1:] + (0.3 if name == "q" else 0.0)])


def _motions() -> Iterator[tuple[str, str, Make]]:
    yield "off its path in the middle", "short", moved(lambda x: bump(x, 2, 0.05))
    yield "5 mm off at one via-point", "short", moved(lambda x: bump(x, 2, 0.004, slice(4, 5)))
    yield "tool rolled by 40 degrees", "short", moved(lambda x: offset(x, 6, np.radians(40)))
    yield "tool turned by 3 degrees on its way", "short", moved(lambda x: bump(x, 6, np.radians(3)))
    yield "ahead of its time", "short", moved(warped)
    yield "slower by a tenth", "short", moved(lambda x: stretched(x, 1.1))
    yield "trembling", "short", moved(trembling)
    yield "moving when it begins", "short", moved(lambda x: rates(x, "v", 0, 0.02))
    yield "a jolt of acceleration", "short", moved(lambda x: rates(x, "a", 4, 3.0))
    yield "a turn more of the last joint", "short", moved(lambda x: offset(x, 6, 2 * np.pi))
    yield "an approach twice as quick", "sliding", moved(lambda x: stretched(x, 0.3), "approach")
    away = moved(lambda x: bump(x, 2, 0.002, slice(-1, None)), "approach")
    yield "an approach that ends 2 mm away", "sliding", away
    yield "a return through the rail", "strokes", moved(lambda x: detour(x, 1, -1.2), "return")
    yield "a return half way", "strokes", moved(lambda x: bump(x, 1, 0.2, slice(-1, None)), "return")
    yield "a free move that swings into the bar", "bar", moved(lambda x: bump(x, 0, 0.12))
    yield "a return that sets off at once", "ramp", moved(at_once, "return")
    yield "a motion after the end", "short", _knots(_after_the_end)


_LEG = "tool_path.legs[0]"
_SCENES: tuple[tuple[str, str, Data], ...] = (
    ("a leg of 250 mm", "short", {f"{_LEG}.by": [0, -0.25, 0]}),
    ("a leg 3 mm askew", "short", {f"{_LEG}.by": [0, -0.3, 0.003]}),
    ("a leg in 5 s", "short", {f"{_LEG}.seconds": 5}),
    ("another profile", "short", {"tool_path.speed_profile": {"kind": "jerk_limited", "ramp": 0.5}}),
    ("a bar that is not there", "near", {"obstacles": []}),
    ("a bar 20 mm away", "near", {"obstacles[0].xyz": [1.89, 0.63, -2.0628]}),
    ("the nozzle without its recoil", "strokes", {"tool": None}),
    ("no payload", "heavy", {"robot.payload_kg": 0.0}),
    ("half the payload", "heavy", {"robot.payload_kg": 1.0}),
    ("a tool 20 mm shorter", "short", {"robot.tool_length_m": 0.28, "start": BASES["short"]["start"]}),
    ("a tool 20 mm shorter, no baseline", "alone", {"robot.tool_length_m": 0.28}),
    ("a guardrail three times as stiff", "bent", {"guardrail.stiffness_factor": 3.0}),
    ("feet 5 mm further", "stands", FURTHER),
    ("limits doubled in a file of its own", "panda", {"robot.limits": DOUBLED}),
    ("rows that lack the last", "rows", {"tool_path.raster.v": [0, 0, -0.05]}),
    ("rows 50 mm lower", "rows", {"frames.plate.xyz": [1.9354, 0.55, -2.25]}),
    ("rows at 17 cm", "rows", {"tool_path.raster.stand_off_m": 0.17}),
    ("rows on which the tool leans", "rows", {"tool_path.raster.lean_deg": [0, 5]}),
    ("one stroke of two", "strokes", {"tool_path.strokes[1]": None}),
    ("a stroke backwards", "strokes", {"tool_path.strokes[1].backwards": True}),
    ("no return", "strokes", {"return": None}),
    ("a pause left out", "turns", {"tool_path.legs[1].pause": 0.1}),
    ("another place of the foot", "short", {"guardrail": {"bays": 0}, f"{_LEG}.by": [0, -0.3, 0.02]}),
    ("another start", "short", {"start.posture_deg": [-12, -90, 90, 0, 10, 50, 0]}),
)


def _scenes() -> Iterator[tuple[str, str, Make]]:
    for name, base, changes in _SCENES:
        yield name, base, other(base, changes)
        if base in ("alone", "bent", "stands"):
            yield f"{name}, its figures computed anew", base, remade(base, changes)
    axis = moved(lambda x: bump(x, 6, 0.2))
    yield "the axis alone", "short", all_of(other("short", {"tool_path.keep": "axis"}), axis)
    yield "a smaller mesh", "mesh", other("mesh", {"obstacles[0].mesh": SMALL})


def _options() -> Iterator[tuple[str, str, Make]]:
    for keep, words in ((("options",), "which the folder says"), ((), "which the folder hides")):

        def of(changes: Data, base: str = "short", keep: tuple[str, ...] = keep) -> Make:
            return other(base, {f"planner.{key}": value for key, value in changes.items()}, keep=keep)

        loose = of({"max_tool_deviation_m": 0.1, "max_tool_rotation_deg": 90, "max_tool_lag_m": 0.2})
        for what, motion in (
            ("a deviation of 5 mm", lambda x: bump(x, 2, 0.004, slice(4, 5))),
            ("a turn of 3 degrees", lambda x: bump(x, 6, np.radians(3))),
            ("a lag", warped),
        ):
            yield f"{what}, {words}", "short", all_of(loose, moved(motion))
        yield f"no margin, {words}", "near", of({"safety_margin_m": 0.0}, "near")
        sliding = moved(lambda x: offset(x, 6, 0.01))
        yield f"no approach, {words}", "sliding", all_of(of({"knots": "fixed"}, "sliding"), sliding)
    for name, margin, keep in (("not a number", float("nan"), ()), ("negative", -1.0, ("options",))):
        bare = other("near", {"planner.safety_margin_m": 0.0}, keep=keep)
        yield f"a margin that is {name}", "near", all_of(bare, told(options__safety_margin_m=margin))
    endless = told(options__max_tool_deviation_m=1e9)
    yield "an endless deviation", "short", all_of(moved(lambda x: bump(x, 2, 0.05)), endless)


def _files() -> Iterator[tuple[str, str, Make]]:
    yield "joint 2 a milliradian away", "short", column("q2", lambda x, k: x + 1e-3)
    yield "one row elsewhere", "short", column("q2", lambda x, k: x + (0.2 if k == 200 else 0.0))
    yield "twice as quick", "short", column("t", lambda x, k: x / 2)
    yield "rows left out", "short", table(lambda rows: rows[:100] + rows[200:])
    yield "a row more", "short", table(lambda rows: [*rows, {**rows[-1], "t": "4.5"}])
    yield "half the torque on the base", "short", column("guardrail_torque_x", lambda x, k: x / 2)
    yield "half the torque of a joint", "short", column("tau2", lambda x, k: x / 2)
    yield "the tool elsewhere", "short", column("tool_z", lambda x, k: x + 0.01)
    yield "velocities of nothing", "short", column("v2", lambda x, k: 0.0)
    renamed = table(lambda rows: [{**r, "segment": r["segment"].replace("back", "return")} for r in rows])
    yield "work that is called a return", "strokes", renamed
    exchanged = table(lambda rows: [{**row, "q1": row["q2"], "q2": row["q1"]} for row in rows])
    yield "columns exchanged", "short", exchanged
    yield "accelerations of nothing", "short", column("a2", lambda x, k: 0.0)
    yield "a table ten times as quick, beside the message", "short", column("t", lambda x, k: x / 10)
    yield "a table beside its honest part", "short", all_of(part("job.csv"), column("t", lambda x, k: x / 3))
    yield "knots beside their honest part", "short", all_of(part("job.npz"), _knots(_half))
    lower = told(planned__peak_guardrail_torque=lambda x: 0.5 * x)
    yield "a record beside its honest part", "short", all_of(part("plan.json"), lower)


def _exports() -> Iterator[tuple[str, str, Make]]:
    yield "twice as quick", "short", exported(_quicker)
    yield "twice as quick, then a rest", "short", exported(lambda x: _quicker(x, rest=True))
    yield "joints exchanged", "short", exported(lambda x: x["joint_names"].reverse())
    still = exported(lambda x: [point.update(velocities=[0.0] * 7) for point in x["points"]])
    yield "velocities of nothing", "short", still
    yield "its ends alone", "short", exported(lambda x: x.update(points=x["points"][:: len(x["points"]) - 1]))
    yield "other points before its own", "short", all_of(exported(lambda x: None), _twice)


def _quicker(message: Data, *, rest: bool = False) -> None:
    last = copy.deepcopy(message["points"][-1])
    for point in message["points"]:
        since = point["time_from_start"]
        since["sec"], since["nanosec"] = divmod((since["sec"] * 10**9 + since["nanosec"]) // 2, 10**9)
    message["points"] += [last] if rest else []


def _twice(folder: Path) -> None:
    """Readers that take the first of two keys find a motion twice as quick."""
    file = folder / "job.json"
    text = file.read_text(encoding="utf-8")
    quick = json.loads(text)
    _quicker(quick)
    file.write_text(f'{{"points": {json.dumps(quick["points"])}, {text[1:]}', encoding="utf-8")


def _claims() -> Iterator[tuple[str, str, Make]]:
    yield "a lower peak", "short", told(planned__peak_guardrail_torque=lambda x: 0.9 * x)
    yield (
        "a lower peak everywhere",
        "short",
        told(
            planned__peak_guardrail_torque=lambda x: 0.9 * x,
            segments__0__peak_guardrail_torque=lambda x: 0.9 * x,
            planned__job__peak_guardrail_torque=lambda x: 0.9 * x,
        ),
    )
    yield "a lower objective", "short", told(objective__planned_peak=lambda x: 0.9 * x)
    yield "more clearance", "short", told(planned__min_clearance=lambda x: x + 0.05)
    yield "a smaller deviation", "bar", told(planned__max_tool_deviation=lambda x: 0.0)
    yield "a shorter job", "strokes", told(planned__job__duration=lambda x: x - 3)
    bound = told(torque_floor=lambda x: 2 * x, floor__value=lambda x: 2 * x)
    yield "a bound above the peak", "sliding", bound
    # By less than what two enclosures of it may differ by.
    certificate = "certificate__", "segments__0__certificate__"
    more = {key + "clearance_bound": lambda x: x + 1.5e-4 for key in certificate}
    less = {key + "guardrail_torque_bound": lambda x: 0.995 * x for key in certificate}
    yield "a clearance for all times above the smallest", "short", told(**more)
    yield "a torque for all times below the peak", "short", told(**less)


def walk(*changes: Callable[[dict[str, Any]], object]) -> Make:
    """Change ``walk.json``."""

    def make(folder: Path) -> None:
        for change in changes:
            edit(folder, change, "walk.json")

    return make


def _moves(record: dict[str, Any]) -> list[dict[str, Any]]:
    return record["steps"][0]["moves"]


def _low(share: float) -> Callable[[Data], None]:
    """The foot is lifted by a share of its way alone, and swings so low."""
    t = np.linspace(0, 4, 9)
    law = make_interp_spline(t, [0, 1, 0, -1, 0, -1, 0, 1, 0], k=1).antiderivative(3)
    end = float(law(4.0))

    def change(record: Data) -> None:
        moves = _moves(record)[-3:]
        whole = [QuinticTrajectory(**{name: np.array(m["knots"][name]) for name in "tqva"}) for m in moves]
        up, down = whole[0], whole[2]
        high = [x.evaluate([x.t[-1] * s])[0] for x, s in ((up, share), (down, 1 - share))]
        places, begin = [up.q[0], *high, down.q[-1]], moves[0]["begin"]
        for move, first, last in zip(moves, places, places[1:], strict=False):
            rates = [
                (first * (k == 0) + law(t, k)[:, None] / end * (last - first)).tolist() for k in range(3)
            ]
            move["knots"] = dict(zip("tqva", (t.tolist(), *rates), strict=True))
            move["begin"], move["seconds"], begin = begin, 4.0, begin + 4.0
        record["seconds"] = begin

    return change


def _quick(factor: float) -> Callable[[dict[str, Any]], None]:
    def change(record: dict[str, Any]) -> None:
        begin = 0.0
        for move in _moves(record):
            knots = move["knots"]
            for name, power in (("t", -1), ("v", 1), ("a", 2)):
                knots[name] = (np.array(knots[name]) * factor**power).tolist()
            move["seconds"], move["begin"] = move["seconds"] / factor, begin
            begin += move["seconds"]
        record["seconds"] = begin

    return change


def _without(kind: str) -> Callable[[dict[str, Any]], None]:
    def change(record: dict[str, Any]) -> None:
        record["steps"][0]["moves"] = [move for move in _moves(record) if move["kind"] != kind]

    return change


def _goal(record: dict[str, Any]) -> None:
    """As if the foot had been set down 20 mm further."""
    record["goal"]["foot_1"]["along_m"] += 0.02
    record["steps"][0]["after"]["foot_1"]["along_m"] += 0.02


def _arm_in_the_air(record: dict[str, Any]) -> None:
    for move in _moves(record)[-2:]:
        move["arm"][1] += 0.2


def _walks() -> Iterator[tuple[str, str, Make]]:
    yield "a foot that is dragged", "walk", walk(_low(0.0))
    yield "a foot that goes 4 mm above the rail", "walk", walk(_low(0.2))
    yield "three times as quick", "walk", walk(_quick(3.0))
    yield "no lift", "walk", walk(_without("lift"))
    yield "no set", "walk", walk(_without("set"))
    yield "another goal", "walk", walk(_goal)
    yield "an arm that moves with a foot in the air", "walk", walk(_arm_in_the_air)
    yield "the swing called a lift", "walk", walk(lambda x: _moves(x)[-2].update(kind="lift"))
    yield "no steps", "walk", walk(lambda x: x.update(steps=[]))
    yield "a table that ends early", "walk", _walk_table(lambda rows: rows[:-30])
    elsewhere = _walk_table(lambda rows: [{**r, "foot_1_x": float(r["foot_1_x"]) + 0.01} for r in rows])
    yield "a table with the foot elsewhere", "walk", elsewhere


def tour(*changes: Callable[[Data], object]) -> Make:
    """Change ``tour.json``; its clock is made right."""

    def clocked(record: Data) -> None:
        record["seconds"] = 0.0
        for entry in record["parts"]:
            entry["begin"] = record["seconds"]
            record["seconds"] += entry["seconds"]

    def make(folder: Path) -> None:
        for change in (*changes, clocked):
            edit(folder, change, "tour.json")

    return make


def inside(name: str, make: Make) -> Make:
    """Do it to a part of a tour."""
    return lambda folder: make(folder / name)


def _tours() -> Iterator[tuple[str, str, Make]]:
    yield "parts exchanged", "tour", tour(lambda x: x["parts"].reverse())
    yield "the work twice", "tour", tour(lambda x: x["parts"].insert(0, copy.deepcopy(x["parts"][0])))
    yield "the work left out", "tour", tour(lambda x: x["parts"].pop(0))
    yield "the walk twice", "tour", tour(lambda x: x["parts"].append(x["parts"][1]))
    yield "the job of its work quicker", "tour", inside("work_1", column("t", lambda x, k: x / 2))
    yield "knots of its work quicker", "tour", inside("work_1", _knots(_half))
    yield "a foot that is dragged", "tour", inside("walk_1", walk(_low(0.0)))
    yield "feet 5 mm further in its walk", "tour", inside("walk_1", walk(_further))
    yield "work from 5 mm further", "tour", inside("work_1", other("tour", FURTHER))
    yield "less torque in its work", "tour", tour(lambda x: x["parts"][0].update(peak_torque=100.0))


def _further(record: Data) -> None:
    stances = [record["goal"], record["scene"]["guardrail"]["stance"]]
    stances += [step[key] for step in record["steps"] for key in ("before", "after")]
    for stance in stances:
        for foot in ("foot_1", "foot_2"):
            stance[foot]["along_m"] += 0.005


def _walk_table(change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]]) -> Make:
    return table(change, "walk.csv", "walk.json")


FORGERIES: tuple[Forgery, ...] = tuple(
    Forgery(name=name, category=category, base=base, make=make)
    for category, some in (
        ("motion", _motions),
        ("scene", _scenes),
        ("options", _options),
        ("files", _files),
        ("exports", _exports),
        ("claims", _claims),
        ("walks", _walks),
        ("tours", _tours),
    )
    for name, base, make in some()
)
"""Sorted by categories."""
