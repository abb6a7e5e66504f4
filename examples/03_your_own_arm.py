"""Plan an arm of your own: a URDF, a joint-limits file, a scene.

Run it with ``python examples/03_your_own_arm.py``.

The arm is made up here: seven joints, upright on a rigid pedestal, a sanding disc of 1 kg at its end, which
follows two straight legs above a table. Everything is written to a temporary folder, as you would write it to
yours.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cmbot
from cmbot.planning import remarks

# Joint i: axis, distance of the next joint along z (m), mass of its link (kg), torque bound (Nm).
JOINTS = [
    ("0 0 1", 0.20, 5.0, 200),
    ("0 1 0", 0.24, 4.5, 200),
    ("0 0 1", 0.24, 3.5, 120),
    ("0 1 0", 0.22, 3.0, 120),
    ("0 0 1", 0.22, 2.0, 60),
    ("0 1 0", 0.10, 1.5, 60),
    ("0 0 1", 0.08, 0.8, 60),
]
RADIUS = 0.05
TOOL = 0.15  # m from the last joint's link to the disc


def link(name: str, length: float, mass: float) -> str:
    """Return a rod along z with its mass, inertia and collision shape."""
    across = mass * (3 * RADIUS**2 + length**2) / 12
    return f"""
  <link name="{name}">
    <inertial>
      <origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>
      <inertia ixx="{across}" iyy="{across}" izz="{mass * RADIUS**2 / 2}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision>
      <origin xyz="0 0 {length / 2}"/><geometry><cylinder radius="{RADIUS}" length="{length}"/></geometry>
    </collision>
  </link>"""


def urdf() -> str:
    """Return the arm's URDF: velocity and torque bounds are in it, acceleration and jerk are not."""
    parts = [link("pedestal", 0.3, 20.0)]
    parent, height = "pedestal", 0.36
    for number, (axis, length, mass, torque) in enumerate(JOINTS, start=1):
        parts.append(link(f"link_{number}", length, mass))
        parts.append(f"""
  <joint name="joint_{number}" type="revolute">
    <parent link="{parent}"/><child link="link_{number}"/><origin xyz="0 0 {height}"/><axis xyz="{axis}"/>
    <limit lower="-2.8" upper="2.8" velocity="1.5" effort="{torque}"/>
  </joint>""")
        parent, height = f"link_{number}", length
    parts.append(f"""
  <link name="disc"/>
  <joint name="disc_joint" type="fixed">
    <parent link="link_7"/><child link="disc"/><origin xyz="0 0 {TOOL}"/>
  </joint>""")
    return f'<robot name="sander">{"".join(parts)}\n</robot>\n'


LIMITS = "format: cmbot-joint-limits/1\njoints:\n" + "".join(
    f"  joint_{number}: {{acceleration_deg: 100, jerk_deg: 400}}\n" for number in range(1, 8)
)

SCENE = """\
format: cmbot-scene/2
name: sanding

robot:
  model: sander.urdf  # relative to this file, as every path in it
  base_frame: pedestal
  tool_frame: disc
  limits: sander_limits.yaml
  mount: {xyz: [0, 0, 0], rpy_deg: [0, 0, 0]}  # where the base frame is held, in W
  payload_kg: 1.0

start: {posture_deg: [0, 35, 0, 85, 0, 60, 0]}  # the tool point straight ahead, its axis down

tool_path:
  keep: axis  # a disc may spin about its axis
  legs:
    - {by: [0.10, 0.20, 0], seconds: 4}
    - {by: [0.05, -0.15, 0], seconds: 3}
  speed_profile: {kind: jerk_limited, ramp: 0.3}
  via_points: 12

obstacles:
  - {name: table, box: [0.6, 1.0, 0.04], xyz: [0.75, 0, 0.43], workpiece: true}
  - {name: lamp, sphere: 0.10, xyz: [0.40, -0.45, 0.9]}

guardrail: {bays: 0}  # no guardrail: nothing of it to hit, and a rigid hold
# Any option of cmbot.PlannerOptions. The sparse solver, of the extra "fast", is the quicker one here.
planner: {knots: sliding, solver: auto}
"""

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    (folder / "sander.urdf").write_text(urdf(), encoding="utf-8")
    (folder / "sander_limits.yaml").write_text(LIMITS, encoding="utf-8")
    (folder / "sanding.yaml").write_text(SCENE, encoding="utf-8")

    scene = cmbot.load_scene(folder / "sanding.yaml")
    plan = cmbot.plan(scene)
    print(f"{plan.robot.name}: {plan.robot.dof} joints, {plan.robot.arm_mass:.1f} kg moving")
    print(plan.summary())
    print(*remarks(plan), sep="\n")

    # What goes wrong has a type, and says where and what to do.
    try:
        cmbot.load_robot(folder / "sander.urdf", base_frame="pedestal", tool_frame="dsic", limits="none.yaml")
    except cmbot.ModelError as error:
        print(f"\nA slip is told like this: {error.key}: got {error.got}, expected {error.expected}")
