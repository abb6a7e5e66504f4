"""Small robots whose links bend, written to files and loaded."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from cmbot.elastic import ElasticBase
from cmbot.elastic.arm import ElasticArm, ElasticOptions, elastic_arm
from cmbot.robot import Robot, load_robot

FloatArray = NDArray[np.float64]

YOUNG, SHEAR = 70e9, 26e9


@dataclass
class Link:
    """A link below a joint at `xyz`, `rpy` in the link before; `inertia` (3, 3) is about `com`."""

    mass: float
    com: FloatArray
    inertia: FloatArray
    xyz: FloatArray
    rpy: FloatArray
    axis: FloatArray
    tube: dict[str, Any] | None = None


def tube(start: Any, end: Any, diameter: float = 0.06, wall: float = 0.003) -> dict[str, Any]:
    return {
        "start_m": np.asarray(start, dtype=float).tolist(),
        "end_m": np.asarray(end, dtype=float).tolist(),
        "outer_diameter_m": diameter,
        "wall_m": wall,
        "young_pa": YOUNG,
        "shear_pa": SHEAR,
    }


def write_robot(folder: Path, links: list[Link], tool: Any, **options: Any) -> Robot:
    """Write and load a chain ``base``, ``link_1``, … whose tool is at `tool` in the last link."""
    parts = ['<robot name="chain"><link name="base"><inertial><origin xyz="0.1 0.2 -0.1"/>']
    parts.append(
        '<mass value="5"/><inertia ixx=".2" iyy=".3" izz=".4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    for i, link in enumerate(links, start=1):
        tensor = link.inertia
        parts.append(
            f'<link name="link_{i}"><inertial><origin xyz="{_text(link.com)}"/><mass value="{link.mass!r}"/>'
            f'<inertia ixx="{tensor[0, 0]:.17g}" iyy="{tensor[1, 1]:.17g}" izz="{tensor[2, 2]:.17g}" '
            f'ixy="{tensor[0, 1]:.17g}" ixz="{tensor[0, 2]:.17g}" iyz="{tensor[1, 2]:.17g}"/>'
            f'</inertial></link><joint name="joint_{i}" type="revolute">'
            f'<parent link="{f"link_{i - 1}" if i > 1 else "base"}"/>'
            f'<child link="link_{i}"/><origin xyz="{_text(link.xyz)}" rpy="{_text(link.rpy)}"/>'
            f'<axis xyz="{_text(link.axis)}"/><limit lower="-3" upper="3" velocity="1" effort="100"/></joint>'
        )
    parts.append(
        f'<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="link_{len(links)}"/>'
        f'<child link="tip"/><origin xyz="{_text(tool)}" rpy="0.3 -0.2 0.5"/></joint></robot>'
    )
    folder.mkdir(exist_ok=True)
    (folder / "arm.urdf").write_text("".join(parts), encoding="utf-8")
    limits = {f"joint_{i}": {"acceleration_deg": 90, "jerk_deg": 90} for i in range(1, len(links) + 1)}
    _write(folder / "joint_limits.yaml", {"format": "cmbot-joint-limits/1", "joints": limits})
    tubes = {f"link_{i}": link.tube for i, link in enumerate(links, start=1) if link.tube is not None}
    _write(folder / "arm.elasticity.yaml", {"format": "cmbot-elasticity/1", "links": tubes})
    return load_robot(folder / "arm.urdf", base_frame="base", tool_frame="tip", **options)


def cantilever(folder: Path, *, length: float, mass: float, direction: int = 0, **options: Any) -> Robot:
    """A uniform tube along axis `direction` of its link, on one joint about z at W; the tool at its end."""
    u = np.eye(3)[direction]
    # As a rod, with next to no inertia about its own axis.
    inertia = mass * length**2 / 12 * (np.eye(3) - np.outer(u, u)) + 1e-9 * mass * np.eye(3)
    link = Link(
        mass=mass, com=length / 2 * u, inertia=inertia, xyz=np.zeros(3), rpy=np.zeros(3),
        axis=np.array([0.0, 0, 1]), tube=tube(np.zeros(3), length * u),
    )  # fmt: skip
    return write_robot(folder, [link], length * u, **options)


def random_robot(folder: Path, rng: np.random.Generator, joints: int, **options: Any) -> Robot:
    """A chain of any shape and any inertia that is possible; two thirds of its links bend."""
    links = []
    for i in range(joints):
        spread = rng.normal(size=(3, 3)) * 0.2
        covariance = spread @ spread.T
        mass = rng.uniform(0.5, 5)
        axis = rng.normal(size=3)
        links.append(
            Link(
                mass=mass,
                com=rng.uniform(-0.4, 0.4, 3),
                inertia=mass * (np.trace(covariance) * np.eye(3) - covariance),
                xyz=rng.uniform(-0.5, 0.5, 3),
                rpy=rng.uniform(-3, 3, 3),
                axis=axis / np.linalg.norm(axis),
                tube=tube(rng.uniform(-0.3, 0.1, 3), rng.uniform(0.2, 0.6, 3)) if i % 3 != 1 else None,
            )
        )
    return write_robot(folder, links, rng.uniform(-0.3, 0.3, 3), **options)


def make_arm(robot: Robot, base: ElasticBase | None = None, **options: Any) -> ElasticArm:
    return elastic_arm(robot, base, ElasticOptions(**options))


def make_random_arm(folder: Path, rng: np.random.Generator, joints: int) -> ElasticArm:
    """A random robot with a payload on a random hold, its links soft and in two segments."""
    robot = random_robot(folder, rng, joints, payload=1.0)
    return make_arm(robot, random_base(rng), segments=2, link_factor=0.05)


def mass_matrix(model: Any, q: FloatArray) -> FloatArray:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def random_base(rng: np.random.Generator) -> ElasticBase:
    """A hold of about 1e6 N/m and 1e5 Nm/rad, with mass, coupled throughout."""
    scale = np.sqrt([1e6] * 3 + [1e5] * 3)
    square = 0.3 * rng.normal(size=(6, 6))
    mass = rng.normal(size=(6, 6))
    stiffness = scale[:, None] * (np.eye(6) + square @ square.T) * scale
    return ElasticBase(
        stiffness=(stiffness + stiffness.T) / 2,
        mass=mass @ mass.T,
        damping=np.zeros((6, 6)),
    )


def second_moment(diameter: float = 0.06, wall: float = 0.003) -> float:
    """Of a tube's area, about a diameter, m4."""
    return float(np.pi / 4 * ((diameter / 2) ** 4 - (diameter / 2 - wall) ** 4))


def _text(vector: Any) -> str:
    return " ".join(f"{value:.17g}" for value in vector)


def _write(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data), encoding="utf-8")  # JSON is YAML 1.2
