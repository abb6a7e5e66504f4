"""The numbers of the robot: the paper's tables, and the choices that settle what the paper leaves open.

The arm is Chang 2021, Tables 1 to 3. The climbing mechanism is known from the paper only by its joints and
its mass; its geometry here is a design of ours, and the mass properties of one body (ankle_1) are solved for,
so that the whole has the mass, the centre of mass and the inertia that are wanted in the working stance.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

# --- The arm: Chang 2021, Tables 1 to 3 ---
# alpha_{i-1} (deg), a_{i-1} (m), d_i (m); modified (Craig) convention.
DH = [(0, 0, 0), (-90, 0.83, 0), (0, 1.0, 0), (0, 0.78, 0), (90, 0, 0.87), (-90, 0, 0), (90, 0, 0)]
ARM_MASS = [7.8, 7.4, 7.7, 4.9, 3.7, 2.5, 3.62]
# Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass. Links 3 and 4 of Table 2 are no possible rigid
# bodies; these are the nearest ones that are (Frobenius norm). The others are Table 2 to the letter.
ARM_INERTIA = [
    (0.02, 0.32, 0.32, 0, -0.01, 0),
    (0.04, 0.46, 0.45, -0.01, 0.06, 0),
    (0.06668, 0.56731, 0.58335, 0.01087, 0.11697, -0.00060),
    (0.04910, 0.03122, 0.03122, -0.00910, 0.00910, 0.00033),
    (0.25, 0.25, 0.01, 0, 0.01, 0.01),
    (0.01, 0.01, 0.003, 0, 0, 0.001),
    (0.03, 0.09, 0.07, -0.01, 0.01, 0),
]
VELOCITY_DEG = [20, 20, 20, 30, 30, 30, 30]
ACCELERATION_DEG = [60, 60, 60, 90, 90, 90, 90]
JERK_DEG = [160, 160, 160, 240, 240, 240, 240]
TORQUE = [240, 240, 240, 160, 160, 160, 160]

# --- The arm: what the paper leaves open ---
ARM_COM: list[Vector] = [
    (0.415, 0, 0), (0.5, 0, 0), (0.39, 0, 0), (0, -0.10, 0), (0, 0, -0.435), (0, 0, 0), (0, 0, 0.10),
]  # fmt: skip
RANGE_DEG = [170, 170, 150, 170, 170, 130, 170]
TOOL_LENGTH = 0.30
YOUNG_PA, SHEAR_PA = 70e9, 26e9  # aluminium

# --- The climbing mechanism: geometry and masses are ours ---
CLIMBER_MASS = 30.38  # 68 kg less the 37.62 kg of Table 2
CLIMBER_COM = (0.0, 0.25, 0.0)  # in the world frame, in the working stance
CLIMBER_INERTIA = 0.6  # about each axis through the centre of mass, kg m2
# The ankle's pitch axis lies this far beside the axis of the foot, so that the legs pass above link_1.
ANKLE_RISE = 0.16
FOOT_HEIGHT, ANKLE_HEIGHT = 0.075, 0.055
LEG, LEG_OFFSET = 0.43, 0.19  # the legs lie side by side, so that the knee folds flat
# The legs lie beside the planes of their feet: arm_base hangs between them.
ANKLE_SIDE, FOOT_SIDE = 0.075, 0.045
STANCE_DEG = {"climb_1": -90, "climb_2": 0, "climb_3": 180, "climb_4": -45, "climb_5": 0}
# Folded under the base, clear of the guardrail and of both shipped scenes' obstacles.
STOW_DEG = {
    **{"joint_1": 25, "joint_2": -147, "joint_3": 42, "joint_4": 160},
    **{"joint_5": -90, "joint_6": -90, "joint_7": -30},
}
CLIMB_VELOCITY, CLIMB_EFFORT = 0.2, 200
# What the brakes of the climbing joints hold, Nm: tools/holding_torque.py.
CLIMB_HOLDING = 460


@dataclass(frozen=True, kw_only=True)
class Body:
    """Mass (kg), centre of mass (m), inertia about it (kg m2: xx, yy, zz, xy, xz, yz) in the link's frame."""

    mass: float
    com: Vector
    inertia: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Tube:
    """What a link bends like: ends of its axis (m) in the link's frame, outer diameter and wall (m)."""

    start: Vector
    end: Vector
    outer_diameter: float
    wall: float


@dataclass(frozen=True, kw_only=True)
class Joint:
    """One joint at its zero; a fixed one has no axis. Angles in degrees."""

    name: str
    parent: str
    child: str
    xyz: Vector = (0, 0, 0)
    rpy_deg: Vector = (0, 0, 0)
    axis: Vector | None = None
    range_deg: float = 0
    velocity: float = 0
    effort: float = 0
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A primitive: box (three sides), or cylinder or capsule (radius, length) along `axis`.

    A capsule's length is the distance between the centres of its caps.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    xyz: Vector
    axis: str = "z"


def solid_box(mass: float, com: Vector, sides: Vector) -> Body:
    """Return a homogeneous box."""
    x2, y2, z2 = (side**2 for side in sides)
    diagonal = (mass * (y2 + z2) / 12, mass * (x2 + z2) / 12, mass * (x2 + y2) / 12)
    return Body(mass=mass, com=com, inertia=(*(round(value, 6) for value in diagonal), 0, 0, 0))


# From joint to joint. The tube between joint 4 and the wrist is link_5's: it lies on the axis of joint 5.
TUBES = {
    "link_1": Tube(start=(0, 0, 0), end=(0.83, 0, 0), outer_diameter=0.1, wall=0.004),
    "link_2": Tube(start=(0, 0, 0), end=(1.0, 0, 0), outer_diameter=0.1, wall=0.004),
    "link_3": Tube(start=(0, 0, 0), end=(0.78, 0, 0), outer_diameter=0.1, wall=0.004),
    "link_5": Tube(start=(0, 0, -0.87), end=(0, 0, 0), outer_diameter=0.08, wall=0.003),
}

# Torsional stiffness of the drives, Nm/rad: harmonic drives of these sizes have 2e4 to 1e5.
JOINT_STIFFNESS = (1e5, 1e5, 1e5, 5e4, 5e4, 2e4, 2e4)
CLIMB_STIFFNESS = 1e5  # as the arm's largest drives

# Bodies of the climber in their link frames; ankle_1, with the battery and the cabinet, is solved for.
FOOT = solid_box(1.8, (0, 0.065, 0), (0.13, 0.05, 0.15))
CLIMBER_BODIES = {
    "foot_1": FOOT,
    "leg_1": solid_box(1.7, (0, 0.215, -0.03), (0.07, 0.43, 0.07)),
    "arm_base": solid_box(0.8, (0, 0, -0.15), (0.13, 0.13, 0.14)),
    "leg_2": solid_box(1.7, (0, 0.215, 0), (0.07, 0.43, 0.07)),
    "ankle_2": solid_box(1.0, (0.08, 0.03, -0.02), (0.22, 0.08, 0.09)),
    "foot_2": FOOT,
}

COLLISIONS = {
    "foot_1": [Shape(name="foot_1_box", kind="box", size=(0.13, 0.05, 0.15), xyz=(0, 0.065, 0))],
    "ankle_1": [
        Shape(
            name="ankle_1_neck", kind="capsule", size=(0.045, ANKLE_RISE), xyz=(0.08, 0.055, 0.075), axis="x"
        ),
        Shape(name="ankle_1_turn", kind="cylinder", size=(0.045, 0.07), xyz=(0, 0.035, 0), axis="y"),
        Shape(name="ankle_1_cabinet", kind="box", size=(0.11, 0.17, 0.25), xyz=(-0.105, 0.125, 0.075)),
        Shape(name="ankle_1_battery", kind="box", size=(0.08, 0.24, 0.40), xyz=(-0.22, 0.165, 0)),
    ],
    "leg_1": [
        Shape(name="leg_1_capsule", kind="capsule", size=(0.035, LEG), xyz=(0, LEG / 2, 0), axis="y"),
        Shape(name="leg_1_knee", kind="cylinder", size=(0.04, 0.27), xyz=(0, LEG, -0.095)),
    ],
    "arm_base": [Shape(name="arm_base_cylinder", kind="cylinder", size=(0.07, 0.14), xyz=(0, 0, -0.15))],
    "leg_2": [Shape(name="leg_2_capsule", kind="capsule", size=(0.035, LEG), xyz=(0, LEG / 2, 0), axis="y")],
    "ankle_2": [
        Shape(name="ankle_2_neck", kind="capsule", size=(0.045, ANKLE_RISE), xyz=(0.08, 0, 0), axis="x"),
        Shape(name="ankle_2_turn", kind="cylinder", size=(0.045, 0.07), xyz=(0.16, 0.02, -0.045), axis="y"),
    ],
    "foot_2": [Shape(name="foot_2_box", kind="box", size=(0.13, 0.05, 0.15), xyz=(0, 0.065, 0))],
    "link_1": [Shape(name="link_1_capsule", kind="capsule", size=(0.07, 0.83), xyz=(0.415, 0, 0), axis="x")],
    "link_2": [Shape(name="link_2_capsule", kind="capsule", size=(0.06, 1.0), xyz=(0.5, 0, 0), axis="x")],
    "link_3": [Shape(name="link_3_capsule", kind="capsule", size=(0.055, 0.78), xyz=(0.39, 0, 0), axis="x")],
    "link_5": [Shape(name="link_5_capsule", kind="capsule", size=(0.05, 0.87), xyz=(0, 0, -0.435))],
    "tool": [Shape(name="tool_capsule", kind="capsule", size=(0.04, 0.26), xyz=(0, 0, 0.13))],
}


def climb(
    number: int, parent: str, child: str, xyz: Vector, axis: Vector, range_deg: float, note: str
) -> Joint:
    """Return a climbing joint."""
    return Joint(
        name=f"climb_{number}", parent=parent, child=child, xyz=xyz, axis=axis, range_deg=range_deg,
        rpy_deg=(0, 0, 180) if number == 5 else (0, 0, 0), velocity=CLIMB_VELOCITY, effort=CLIMB_EFFORT,
        note=note,
    )  # fmt: skip


def arm_joint(number: int) -> Joint:
    """Return joint `number` of the arm: Rx(alpha) Tx(a) Tz(d), then the turn about z."""
    alpha, a, d = DH[number - 1]
    sine, cosine = {0: (0, 1), 90: (1, 0), -90: (-1, 0)}[alpha]
    return Joint(
        name=f"joint_{number}", parent="arm_base" if number == 1 else f"link_{number - 1}",
        child=f"link_{number}", xyz=(a, -sine * d, cosine * d), rpy_deg=(alpha, 0, 0), axis=(0, 0, 1),
        range_deg=RANGE_DEG[number - 1],
        velocity=math.radians(VELOCITY_DEG[number - 1]), effort=TORQUE[number - 1],
    )  # fmt: skip


Y, Z = (0, 1, 0), (0, 0, 1)
JOINTS = [
    climb(1, "foot_1", "ankle_1", (0, FOOT_HEIGHT, 0), Y, 120, "foot turn about the contact normal"),
    climb(2, "ankle_1", "leg_1", (ANKLE_RISE, ANKLE_HEIGHT, ANKLE_SIDE), Z, 120, "ankle pitch"),
    climb(3, "leg_1", "leg_2", (0, LEG, -LEG_OFFSET), Z, 190, "knee pitch; the legs fold flat, side by side"),
    climb(4, "leg_2", "ankle_2", (0, LEG, 0), Z, 120, "ankle pitch"),
    climb(5, "ankle_2", "foot_2", (ANKLE_RISE, FOOT_HEIGHT + ANKLE_HEIGHT, -FOOT_SIDE), Y, 120, "foot turn"),
    Joint(
        name="arm_base_joint", parent="leg_1", child="arm_base", xyz=(-ANKLE_RISE, 0.37, -ANKLE_SIDE),
        rpy_deg=(180, 90, 0),
        note="In the working stance frame arm_base is at (0, 0.5, 0) in foot_1, turned by Rx(180 deg).",
    ),
    *(arm_joint(number) for number in range(1, 8)),
    Joint(name="tool_joint", parent="link_7", child="tool", note="massless: its mass is counted in link_7"),
    Joint(name="tool_tip_joint", parent="tool", child="tool0", xyz=(0, 0, TOOL_LENGTH), note="l_h, ours"),
]  # fmt: skip
LINKS = ["foot_1", *(joint.child for joint in JOINTS)]
CLIMBER = ["foot_1", "ankle_1", "leg_1", "arm_base", "leg_2", "ankle_2", "foot_2"]


def rotation(axis: Sequence[float], angle_deg: float) -> Array:
    """Return the rotation about a coordinate axis, exact for quarter turns."""
    cosine, sine = (round(f(math.radians(angle_deg)), 15) for f in (math.cos, math.sin))
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=float)
    turned: Array = np.eye(3) + sine * cross + (1 - cosine) * cross @ cross
    return turned


def stance_poses() -> dict[str, tuple[Array, Array]]:
    """Return rotation and origin, in the world frame, of every climber link in the working stance."""
    poses = {"foot_1": (np.eye(3), np.zeros(3))}
    for joint in (joint for joint in JOINTS if joint.child in CLIMBER):
        R_WP, p_WP = poses[joint.parent]
        roll, pitch, yaw = joint.rpy_deg
        R_PC = rotation(Z, yaw) @ rotation(Y, pitch) @ rotation((1, 0, 0), roll)
        if joint.axis is not None:
            R_PC = R_PC @ rotation(joint.axis, STANCE_DEG[joint.name])
        poses[joint.child] = (R_WP @ R_PC, p_WP + R_WP @ np.array(joint.xyz))
    return poses


def tensor(inertia: Sequence[float]) -> Array:
    """Return the 3 x 3 matrix of xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=float)


def about(point: Array, mass: float, com: Array, inertia: Array) -> Array:
    """Return the inertia about `point` (parallel axes)."""
    arm = com - point
    moved: Array = inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return moved


def solve_ankle() -> Body:
    """Return the ankle_1 that gives the climber its mass, centre of mass and inertia in the stance."""
    poses = stance_poses()
    centre = np.array(CLIMBER_COM)
    mass, first, second = CLIMBER_MASS, np.zeros(3), CLIMBER_INERTIA * np.eye(3)
    for name, body in CLIMBER_BODIES.items():
        R_WB, p_WB = poses[name]
        p_WC = p_WB + R_WB @ np.array(body.com)
        mass -= body.mass
        first -= body.mass * (p_WC - centre)
        second -= about(centre, body.mass, p_WC, R_WB @ tensor(body.inertia) @ R_WB.T)
    mass = round(mass, 9)
    offset = first / mass
    R_WA, p_WA = poses["ankle_1"]
    central = R_WA.T @ (second - mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))) @ R_WA
    com = R_WA.T @ (centre + offset - p_WA)
    six = central[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    # Rounded below any meaning, so that the last bits of a machine's arithmetic do not reach the file.
    x, y, z = (round(float(value), 12) + 0.0 for value in com)
    return Body(mass=mass, com=(x, y, z), inertia=tuple(round(float(value), 12) + 0.0 for value in six))


def bodies() -> dict[str, Body]:
    """Return every body with mass; refuse one that cannot exist."""
    arm = {f"link_{i + 1}": Body(mass=ARM_MASS[i], com=ARM_COM[i], inertia=ARM_INERTIA[i]) for i in range(7)}
    everything = {**CLIMBER_BODIES, "ankle_1": solve_ankle(), **arm}
    for name, body in everything.items():
        least, middle, most = np.linalg.eigvalsh(tensor(body.inertia))
        if body.mass <= 0 or least <= 0 or most > least + middle:
            moments = f"mass {body.mass}, principal moments {least:.6g}, {middle:.6g}, {most:.6g}"
            sys.exit(f"{name}: {moments}: no possible rigid body")
    return everything
