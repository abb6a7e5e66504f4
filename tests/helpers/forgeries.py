"""Forged plans: motions and scenes that break what a plan promises, and how to put them into a folder."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from plan_folders import edit, knots, rewrite

from cmbot.archive import load_plan
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning import Certificate, Job, Plan, QuinticTrajectory, certify, robot_of, strokes_of, task_of
from cmbot.scene import Scene

Forge = Callable[[QuinticTrajectory], QuinticTrajectory]


@dataclass(frozen=True, kw_only=True)
class Forgery:
    """A change of the motion or of the scene's entries, and the check that has to fail."""

    name: str
    caught_by: str
    motion: Forge = field(default=lambda x: x)
    scene: Callable[[dict[str, Any]], object] | None = None

    def __str__(self) -> str:
        return self.name


def along(trajectory: QuinticTrajectory, s: FloatArray, ds: FloatArray, dds: FloatArray) -> QuinticTrajectory:
    """The same path at other times: `s` (N,) of the old clock at the knots, and its derivatives."""
    q, v, a = trajectory.states(s)
    t = np.linspace(0, trajectory.t[-1], len(s))
    return QuinticTrajectory(t=t, q=q, v=v * ds[:, None], a=a * ds[:, None] ** 2 + v * dds[:, None])


def standing_still(x: QuinticTrajectory) -> QuinticTrajectory:
    return QuinticTrajectory(t=x.t, q=np.tile(x.q[0], (len(x.t), 1)), v=0 * x.v, a=0 * x.a)


def half_way_and_back(x: QuinticTrajectory) -> QuinticTrajectory:
    u = np.linspace(0, 1, 400)
    T = x.t[-1]
    s, ds, dds = (
        T * (1 - np.cos(2 * np.pi * u)) / 4,
        np.pi / 2 * np.sin(2 * np.pi * u),
        np.pi**2 / T * np.cos(2 * np.pi * u),
    )
    return along(x, s, ds, dds)


def reversed_in_time(x: QuinticTrajectory) -> QuinticTrajectory:
    return QuinticTrajectory(t=x.t[-1] - x.t[::-1], q=x.q[::-1], v=-x.v[::-1], a=x.a[::-1])


def rolled(x: QuinticTrajectory) -> QuinticTrajectory:
    return replace(x, q=x.q + np.radians([0, 0, 0, 0, 0, 0, 60]))


def mirrored(x: QuinticTrajectory) -> QuinticTrajectory:
    sign = np.array([-1, 1, 1, 1, -1, 1, -1])
    return replace(x, q=x.q * sign, v=x.v * sign, a=x.a * sign)


def swapped(x: QuinticTrajectory) -> QuinticTrajectory:
    order = [0, 1, 2, 3, 4, 6, 5]
    return replace(x, q=x.q[:, order], v=x.v[:, order], a=x.a[:, order])


def slower(x: QuinticTrajectory) -> QuinticTrajectory:
    return QuinticTrajectory(t=x.t * 1.02, q=x.q, v=x.v / 1.02, a=x.a / 1.02**2)


def later(x: QuinticTrajectory) -> QuinticTrajectory:
    """The right motion a tenth of a second late, and a rest before it."""
    t = np.concatenate([[0.0], x.t * (1 - 0.1 / x.t[-1]) + 0.1])
    rest = np.zeros_like(x.v[:1])
    return QuinticTrajectory(
        t=t, q=np.vstack([x.q[:1], x.q]), v=np.vstack([rest, x.v]), a=np.vstack([rest, x.a])
    )


def in_another_place(x: QuinticTrajectory) -> QuinticTrajectory:
    return replace(x, q=x.q + np.radians([1, 0, 0, 0, 0, 0, 0]))


def dithering(x: QuinticTrajectory) -> QuinticTrajectory:
    """Through every via-point, but hurrying ahead and falling back between them."""
    middle = 0.5 * (x.t[3] + x.t[4])
    t = np.sort(np.append(x.t, middle))
    q, v, a = (np.array(each) for each in x.states(t))
    q[4] += 0.7 * (x.q[4] - x.q[3])
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def spinning(x: QuinticTrajectory) -> QuinticTrajectory:
    """Through every via-point, but the tool spins about its axis between two of them."""
    t = np.sort(np.append(x.t, 0.5 * (x.t[3] + x.t[4])))
    q, v, a = (np.array(each) for each in x.states(t))
    q[4, 6] += np.radians(3)
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def moving_at_the_start(x: QuinticTrajectory) -> QuinticTrajectory:
    """A first segment of ten microseconds that leaves no last digits, begun at a part of the velocity."""
    t = np.concatenate([[0.0, 1e-5], x.t[1:]])
    q, v, a = (np.array(each) for each in x.states(t))
    v[0] = 1e-5
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def kinked(x: QuinticTrajectory) -> QuinticTrajectory:
    a = x.a.copy()
    a[4, 1] += 1e-6
    return replace(x, a=a)


def _legs(change: Callable[[list[Any]], object]) -> Callable[[dict[str, Any]], object]:
    return lambda data: change(data["tool_path"]["legs"])


PLACE = "distance of the tool from its place at a via-point"
TURN = "rotation of the tool from its orientation at a via-point"
JUMP = "jump of a joint's position, velocity, acceleration or jerk"
TIMES = "difference of the trajectory's times from the tool path's"


def _tool(**entries: object) -> Callable[[dict[str, Any]], object]:
    def change(data: dict[str, Any]) -> None:
        # What is left out means another speed profile in the second format.
        data["tool_path"].setdefault("speed_profile", {"kind": "trapezoidal"})
        data.update(tool=entries)

    return change


FORGERIES = (
    Forgery(name="standing still", caught_by=PLACE, motion=standing_still),
    Forgery(name="half-way and back", caught_by=PLACE, motion=half_way_and_back),
    Forgery(name="reversed", caught_by=PLACE, motion=reversed_in_time),
    Forgery(name="rolled by 60 degrees", caught_by=TURN, motion=rolled),
    Forgery(name="mirrored", caught_by=PLACE, motion=mirrored),
    Forgery(name="two joints swapped", caught_by=PLACE, motion=swapped),
    Forgery(name="in another place", caught_by=PLACE, motion=in_another_place),
    Forgery(name="two per cent slower", caught_by=TIMES, motion=slower),
    Forgery(name="a tenth of a second late", caught_by=PLACE, motion=later),
    Forgery(name="dithering", caught_by="tool lag", motion=dithering),
    Forgery(name="spinning", caught_by="tool rotation", motion=spinning),
    Forgery(name="moving at the start", caught_by=JUMP, motion=moving_at_the_start),
    Forgery(name="kinked", caught_by=JUMP, motion=kinked),
    Forgery(
        name="a shifted leg", caught_by=PLACE, scene=_legs(lambda legs: legs[0]["by"].__setitem__(2, 0.02))
    ),
    Forgery(
        name="a shorter leg", caught_by=PLACE, scene=_legs(lambda legs: legs[0]["by"].__setitem__(1, -0.03))
    ),
    Forgery(
        name="another leg's time",
        caught_by=PLACE,
        scene=lambda data: data["tool_path"].update(
            legs=[{"by": [0, -0.1, 0], "seconds": 1}, {"by": [0, -0.2, 0], "seconds": 3}]
        ),
    ),
    Forgery(
        name="another speed profile",
        caught_by=PLACE,
        scene=lambda data: data["tool_path"].update(speed_profile={"kind": "jerk_limited", "ramp": 0.5}),
    ),
    Forgery(
        name="a heavier payload",
        caught_by="torque of",
        scene=lambda data: data["robot"].update(payload_kg=30.0),
    ),
    Forgery(
        name="a force on the tool", caught_by="torque of", scene=_tool(process_force_n=[0.0, 200.0, -400.0])
    ),
    Forgery(name="a slower tool", caught_by="tool speed", scene=_tool(max_speed_m_s=0.08)),
)


def certified(scene: Scene, planned: Plan, trajectory: QuinticTrajectory) -> Certificate:
    """Certify a trajectory by a scene alone; the options are the plan's."""
    robot = robot_of(scene)
    return certify(
        robot,
        task_of(strokes_of(scene, robot)[0], scene),
        trajectory,
        Clearances(robot, scene.all_obstacles),
        planned.options,
        via_points=scene.strokes[0].via_points,
        sag=planned.sag,
    )


def forge(folder: Path, forgery: Forgery) -> None:
    """Put a forgery into a plan directory, with every hash made right."""
    if forgery.motion is not None:
        planned = load_plan(folder)
        x = forgery.motion(planned.trajectory)
        put_job(folder, planned.job.changed("work", trajectory=x))
        start = np.degrees(x.q[0]).tolist()
        edit(folder, lambda data: data["start"].update(posture_deg=start))
    if forgery.scene is not None:
        edit(folder, lambda data: changed_scene(data, forgery.scene, folder))  # type: ignore[arg-type]


def put_job(folder: Path, job: Job) -> None:
    """Put the motions of a job into a plan directory, with every hash made right."""
    rewrite(folder, "job.npz", knots(job.trajectory))


def changed_scene(data: dict[str, Any], change: Callable[[dict[str, Any]], object], folder: Path) -> None:
    """Change the scene in the content of a plan.json, and the hash of it there."""
    change(data["scene"])
    data["hashes"]["scene"] = Scene.of(data["scene"], "scene", folder).content_hash
