"""Arms with everything that a URDF may say: turned axes, locked joints, branches, all shapes."""

from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from cmbot.scene import Scene, load_scene

_JOINTS = 5
# Links by the joint that carries them; one is not in the URDF, as an SRDF may have it.
_CARRIED = [
    ("root", "pedestal", "base", "nowhere"),
    *((f"link_{i}", f"finger_{i}", f"spacer_{i}") for i in range(1, _JOINTS + 1)),
]


def random_arm(folder: Path, seed: int, *, srdf: bool = True, **robot: Any) -> Scene:
    """A scene with an arm of five joints and with obstacles of all kinds, drawn by a seed."""
    rng = np.random.default_rng(seed)
    urdf = folder / "package" / "urdf" / "arm.urdf"
    urdf.parent.mkdir(parents=True)
    _write_meshes(folder / "package" / "meshes", rng)
    urdf.write_text("\n".join(_urdf(rng)), encoding="utf-8")
    if srdf:
        near = "".join(
            f'<disable_collisions link1="{one}" link2="{other}"/>'
            for ones, others in pairwise(_CARRIED)
            for one, other in product(ones, others)
        )
        stance = '<joint name="turret" value="0.4"/><joint name="finger_2_joint" value="-0.06"/>'
        text = f'<robot name="random"><group_state name="s" group="g">{stance}</group_state>{near}</robot>'
        urdf.with_suffix(".srdf").write_text(text, encoding="utf-8")
    limits = folder / "limits.yaml"
    entries = "".join(
        f"  joint_{i}: {{acceleration_deg: {rng.uniform(50, 200)}, jerk_deg: {rng.uniform(500, 900)}}}\n"
        for i in range(1, _JOINTS + 1)
    )
    limits.write_text(f"format: cmbot-joint-limits/1\njoints:\n{entries}", encoding="utf-8")
    files = {"model": str(urdf), "base_frame": "base", "tool_frame": "tool", "limits": str(limits)}
    mount = {"xyz": rng.uniform(-1, 1, 3).tolist(), "rpy_deg": rng.uniform(-180, 180, 3).tolist()}
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "random",
            "robot": {**files, "mount": mount, **robot},
            "start": {"posture_deg": rng.uniform(-90, 90, _JOINTS).tolist()},
            "tool_path": {
                "legs": [
                    {"by": rng.uniform(-1, 1, 3).tolist(), "seconds": float(rng.uniform(1, 5))}
                    for _ in range(4)
                ],
                "speed_profile": {"kind": "jerk_limited", "ramp": float(rng.uniform(0.05, 0.5))},
                "via_points": 23,
            },
            "obstacles": list(_obstacles(folder, rng)),
        }
    )


def _write_meshes(folder: Path, rng: np.random.Generator) -> None:
    """A link's mesh, which is not convex, and an obstacle's of two parts."""
    folder.mkdir()
    star = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    star.vertices *= rng.uniform(0.4, 1.0, (len(star.vertices), 1))
    star.export(folder / "star.stl")
    far = star.copy()
    far.apply_translation([0.0, 0.5, 0.1])
    trimesh.util.concatenate([star, far]).export(folder / "two.stl")


def _obstacles(folder: Path, rng: np.random.Generator) -> Any:
    shapes = [
        {"box": rng.uniform(0.05, 0.5, 3).tolist(), "workpiece": True},
        {"cylinder": rng.uniform(0.05, 0.5, 2).tolist()},
        {"capsule": rng.uniform(0.05, 0.5, 2).tolist()},
        {"sphere": float(rng.uniform(0.05, 0.5))},
        {"mesh": str(folder / "package" / "meshes" / "two.stl")},
    ]
    for number, shape in enumerate(shapes):
        place = {"xyz": rng.uniform(-3, 3, 3).tolist(), "rpy_deg": rng.uniform(-180, 180, 3).tolist()}
        yield {"name": f"obstacle_{number}", **shape, **place}


def _urdf(rng: np.random.Generator) -> Any:
    """Root, locked turret, base, joints with a spacer and a sliding finger each, tool."""
    yield '<robot name="random">'
    yield from _link("root", rng)
    yield _joint("turret", "revolute", "root", "pedestal", rng)
    yield from _link("pedestal", rng)
    yield _joint("stand", "fixed", "pedestal", "base", rng)
    yield from _link("base", rng)
    parent = "base"
    for i in range(1, _JOINTS + 1):
        yield _joint(f"joint_{i}", "continuous" if i == 2 else "revolute", parent, f"link_{i}", rng)
        yield from _link(f"link_{i}", rng)
        yield _joint(f"finger_{i}_joint", "prismatic", f"link_{i}", f"finger_{i}", rng)
        yield from _link(f"finger_{i}", rng)
        yield _joint(f"spacer_{i}_joint", "fixed", f"link_{i}", f"spacer_{i}", rng)
        yield from _link(f"spacer_{i}", rng, flange=i == _JOINTS)
        parent = f"spacer_{i}"
    yield f'<joint name="tool_joint" type="fixed"><parent link="{parent}"/><child link="tool"/>'
    yield '<origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/></joint>'
    yield '<link name="tool"/></robot>'


def _joint(name: str, kind: str, parent: str, child: str, rng: np.random.Generator) -> str:
    axis = rng.normal(size=3)
    limit = '<limit lower="-2.5" upper="2" velocity="1.5" effort="80"/>'
    origin = _origin(rng.uniform(0.1, 0.3, 3), rng.uniform(-1, 1, 3))
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{origin}'
        f'<axis xyz="{_text(axis)}"/>{limit if kind != "fixed" else ""}</joint>'
    )


def _link(name: str, rng: np.random.Generator, *, flange: bool = False) -> Any:
    spread = np.diag(rng.uniform(0.01, 0.1, 3)) + 0.1
    inertia = np.trace(spread) * np.eye(3) - spread
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    entries = " ".join(f'{key}="{x}"' for key, x in zip(keys, inertia[np.triu_indices(3)], strict=True))
    yield f'<link name="{name}"><inertial>{_origin(rng.normal(size=3) / 5, rng.uniform(-3, 3, 3))}'
    yield f'<mass value="{rng.uniform(0.5, 5)}"/>'
    yield f"<inertia {entries}/></inertial>"
    small = rng.uniform(0.02, 0.08, 7)
    star = "package://package/meshes/star.stl"
    shapes = [
        f'<cylinder radius="{small[0]}" length="{small[1]}"/>',
        f'<box size="{_text(small[2:5])}"/>',
        f'<cylinder radius="{small[5]}" length="{small[6]}"/>',
        f'<mesh filename="{star}" scale="{_text(rng.uniform(0.3, 1.0, 3))}"/>',
        f'<sphere radius="{small[0]}"/>',
    ]
    # Those of the flange are stretched with the tool, which a sphere cannot be; elsewhere one is enough.
    chosen = range(4) if flange else [rng.integers(5)]
    for number in chosen:
        turn = np.zeros(3) if flange and number < 3 else rng.uniform(-3, 3, 3)
        origin = _origin(rng.uniform(-0.1, 0.1, 3), turn)
        yield f'<collision name="{name}_{number}">{origin}<geometry>{shapes[number]}</geometry></collision>'
    yield f'<collision_checking><capsule name="{name}_0"/></collision_checking></link>'


def _origin(xyz: Any, rpy: Any) -> str:
    return f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)
