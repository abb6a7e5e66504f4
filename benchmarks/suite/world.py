"""A scene as the oracle sees it: plain pinocchio and coal, none of cmbot's kinematics, dynamics or distances.

It shares with cmbot only how a scene file is read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from ruamel.yaml import YAML

from cmbot.collision import Box, Capsule, Cylinder, Sphere
from cmbot.scene import Scene
from suite.arms import Arm

__all__ = ["FloatArray", "World", "limits_in"]

FloatArray = NDArray[np.float64]
_ENDLESS = 1e9
_TOLERANCE, _MOST_STEPS, _LONGEST_STEP = 1e-10, 40, 0.5


def limits_in(path: Path, joints: list[str]) -> tuple[FloatArray, FloatArray]:
    """Accelerations and jerks, rad/s2 and rad/s3, of a joint-limits file."""
    entries = YAML(typ="safe").load(path.read_text(encoding="utf-8"))["joints"]
    return tuple(
        np.radians([entries[name][f"{key}_deg"] for name in joints]) for key in ("acceleration", "jerk")
    )


class World:
    """An arm, its mount, its obstacles, and the pose that its tool has to keep.

    Parameters
    ----------
    arm : Arm
    mount : pin.SE3 or None
        Pose of the arm's base in W; None: as in the URDF.
    srdf : Path or None
        Its pairs of links may touch each other, its group states say where other joints are locked.
    margin : float, m

    Attributes
    ----------
    model, geometry
        Of pinocchio, all other joints locked.
    links, carriers
        Link and joint of each of the arm's shapes; joint 0 does not move.
    lower, upper, velocity, torque : (n,)
        Limits in the URDF; endless joints have infinite ranges.
    """

    def __init__(self, arm: Arm, mount: Any = None, srdf: Path | None = None, margin: float = 0.02) -> None:
        text = _one_coordinate_each(arm.urdf)
        full = pin.buildModelFromXML(text)
        shapes = pin.buildGeomFromUrdfString(
            full, text, pin.GeometryType.COLLISION, None, [str(arm.packages)]
        )
        ends = [full.frames[full.getFrameId(link)].parentJoint for link in (arm.base, arm.tool)]
        chain = [joint for joint in full.supports[ends[1]] if joint not in full.supports[ends[0]]]
        self.disabled, stance = _semantics(srdf, full)
        locked = [joint for joint in range(1, full.njoints) if joint not in chain]
        self.model, self._own = pin.buildReducedModel(full, shapes, locked, stance)
        self.n, self.margin = self.model.nv, margin
        self.tool = self.model.getFrameId(arm.tool)
        self.base = self.model.getFrameId(arm.base)
        for shape in self._own.geometryObjects:
            if isinstance(shape.geometry, coal.BVHModelBase):
                points = coal.StdVec_Vec3s()
                points.extend(np.asarray(shape.geometry.vertices()))
                shape.geometry = coal.Convex.convexHull(points, False, "Qt")
        if mount is not None:
            self._move(mount)
        self.links = [self.model.frames[shape.parentFrame].name for shape in self._own.geometryObjects]
        self.carriers = [int(shape.parentJoint) for shape in self._own.geometryObjects]
        self.lower, self.upper = self.model.lowerPositionLimit.copy(), self.model.upperPositionLimit.copy()
        self.lower[self.lower <= -_ENDLESS], self.upper[self.upper >= _ENDLESS] = -np.inf, np.inf
        self.velocity, self.torque = self.model.upperVelocityLimit, self.model.upperEffortLimit
        self.data = self.model.createData()
        self.place([])

    @property
    def joints(self) -> list[str]:
        """Names of the arm's joints."""
        return list(self.model.names)[1:]

    def place(self, obstacles: list[tuple[Any, Any]]) -> None:
        """Put obstacles, coal shapes with their poses in W, around the arm; earlier ones go."""
        self.geometry, joints, links = pin.GeometryModel(self._own), self.carriers, self.links
        self.geometry.removeAllCollisionPairs()
        for i in range(len(joints)):
            for k in range(i):
                if joints[i] != joints[k] and frozenset((links[i], links[k])) not in self.disabled:
                    self.geometry.addCollisionPair(pin.CollisionPair(k, i))
        for number, (shape, X_WO) in enumerate(obstacles):
            at = self.geometry.addGeometryObject(pin.GeometryObject(f"obstacle {number}", 0, X_WO, shape))
            for i in range(len(joints)):
                if joints[i] > 0:
                    self.geometry.addCollisionPair(pin.CollisionPair(i, at))
        self.geometry_data = pin.GeometryData(self.geometry)
        for request in self.geometry_data.collisionRequests:
            request.security_margin = self.margin

    def place_scene(self, scene: Scene) -> None:
        """Put a scene's obstacles around the arm."""
        self.place([(_coal(one.shape), pin.SE3(np.array(one.X_WO))) for one in scene.all_obstacles])

    def _move(self, mount: Any) -> None:
        X = mount * self.model.frames[self.base].placement.inverse()
        for joint in range(1, self.model.njoints):
            if self.model.parents[joint] == 0:
                self.model.jointPlacements[joint] = X * self.model.jointPlacements[joint]
        for frame in self.model.frames:
            if frame.parentJoint == 0:
                frame.placement = X * frame.placement
        for shape in self._own.geometryObjects:
            if shape.parentJoint == 0:
                shape.placement = X * shape.placement

    def random(self, rng: np.random.Generator) -> FloatArray:
        """A random posture (n,) within the ranges, rad."""
        return rng.uniform(np.maximum(self.lower, -np.pi), np.minimum(self.upper, np.pi))

    def pose(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool point (3,), m, and orientation (3, 3)."""
        pin.framesForwardKinematics(self.model, self.data, q)
        X = self.data.oMf[self.tool]
        return X.translation.copy(), X.rotation.copy()

    def in_range(self, q: FloatArray) -> bool:
        """Whether a posture keeps the joints' ranges."""
        return bool((q >= self.lower).all() and (q <= self.upper).all())

    def clear(self, q: FloatArray) -> bool:
        """Whether no counted pair is nearer than the margin."""
        return not pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True)

    def distance(self, q: FloatArray) -> float:
        """Smallest distance of the counted pairs, m."""
        pin.computeDistances(self.model, self.data, self.geometry, self.geometry_data, q)
        return min((r.min_distance for r in self.geometry_data.distanceResults), default=np.inf)

    def holds(self, q: FloatArray) -> bool:
        """Whether the joints can bear the arm at rest."""
        tau = pin.computeGeneralizedGravity(self.model, self.data, q)
        return bool((np.abs(tau) <= self.torque).all())

    def admissible(self, q: FloatArray) -> bool:
        """Whether a posture is in range, can be held at rest and is clear."""
        return self.in_range(q) and self.holds(q) and self.clear(q)

    def gravity_torque(self, q: FloatArray) -> float:
        """Norm of the torque of the arm's weight about the origin of W, Nm."""
        pin.forwardKinematics(self.model, self.data, q)
        torque = np.zeros(3)
        for joint in range(1, self.model.njoints):
            inertia = self.model.inertias[joint]
            torque += np.cross(
                self.data.oMi[joint].act(inertia.lever), inertia.mass * self.model.gravity.linear
            )
        return float(np.linalg.norm(torque))

    def task(self, q: FloatArray, p: FloatArray, R: FloatArray, keep: str) -> tuple[FloatArray, FloatArray]:
        """Error (k,) of the tool, in its own frame, and its Jacobian (k, n)."""
        pin.computeJointJacobians(self.model, self.data, q)
        X = pin.updateFramePlacement(self.model, self.data, self.tool)
        J = pin.getFrameJacobian(self.model, self.data, self.tool, pin.ReferenceFrame.LOCAL)
        away = X.rotation.T @ (p - X.translation)
        if keep == "position":
            return away, J[:3]
        if keep == "pose":
            return np.concatenate([away, pin.log3(X.rotation.T @ R)]), J
        x, y, z = X.rotation.T @ R[:, 2]
        sine = np.hypot(x, y)
        scale = np.arctan2(sine, z) / sine if sine > 1e-12 else 1.0
        return np.concatenate([away, [-y * scale, x * scale]]), J[:5]

    def solve(self, q: FloatArray, p: FloatArray, R: FloatArray, keep: str) -> FloatArray | None:
        """The posture with the tool in its place that damped Newton steps from `q` find; None where none."""
        q, last = q.copy(), np.inf
        for step in range(_MOST_STEPS):
            e, J = self.task(q, p, R, keep)
            size = float(e @ e)
            if size < _TOLERANCE**2:
                return q
            if step > 10 and size > 0.5 * last:
                return None
            last = size if step % 5 == 0 else last
            dq = J.T @ np.linalg.solve(J @ J.T + (1e-12 + 1e-3 * min(size, 1.0)) * np.eye(len(e)), e)
            q += dq * min(1.0, _LONGEST_STEP / max(np.abs(dq).max(), 1e-12))
        return None

    def wrapped(self, q: FloatArray) -> FloatArray | None:
        """The same posture within the ranges, by full turns; None where there is none."""
        q = np.where(np.isfinite(self.lower), q, (q + np.pi) % (2 * np.pi) - np.pi)
        q = np.where(q > self.upper, q - 2 * np.pi * np.ceil((q - self.upper) / (2 * np.pi)), q)
        q = np.where(q < self.lower, q + 2 * np.pi * np.ceil((self.lower - q) / (2 * np.pi)), q)
        return q if self.in_range(q) else None

    def slid(
        self, q: FloatArray, step: FloatArray, p: FloatArray, R: FloatArray, keep: str
    ) -> FloatArray | None:
        """The posture that the part of a `step` in the self-motion leads to; None where there is none."""
        _, J = self.task(q, p, R, keep)
        # Rows that are dependent count once.
        step = step - np.linalg.pinv(J, rcond=1e-6) @ (J @ step)
        return self.solve(q + step, p, R, keep)


def _semantics(srdf: Path | None, model: Any) -> tuple[set[frozenset[str]], FloatArray]:
    """Pairs of links that may touch each other, and the configuration in which joints are locked."""
    q = pin.neutral(model)
    if srdf is None:
        return set(), q
    root = ElementTree.parse(srdf).getroot()
    for joint in root.findall("group_state/joint"):
        q[model.joints[model.getJointId(joint.get("name", ""))].idx_q] = float(joint.get("value", "nan"))
    pairs = root.findall("disable_collisions")
    return {frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in pairs}, q


def _one_coordinate_each(urdf: Path) -> str:
    """A URDF with its endless joints as revolute ones without range, which have one coordinate."""
    root = ElementTree.parse(urdf).getroot()
    for joint in root.findall("joint"):
        for tag in ("dynamics", "calibration", "safety_controller", "mimic"):
            for element in joint.findall(tag):
                joint.remove(element)
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", str(-_ENDLESS))
            limit.set("upper", str(_ENDLESS))
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", str((urdf.parent / name).resolve()))
    return ElementTree.tostring(root, encoding="unicode")


def _coal(shape: Any) -> Any:
    match shape:
        case Box(size=size):
            return coal.Box(*size)
        case Cylinder(radius=radius, length=length):
            return coal.Cylinder(radius, length)
        case Capsule(radius=radius, length=length):
            return coal.Capsule(radius, length)
        case Sphere(radius=radius):
            return coal.Sphere(radius)
    raise NotImplementedError(type(shape).__name__)
