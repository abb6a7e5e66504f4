"""Candidates: every place where feet could hold, with the climber's postures that reach both; or mounts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from cmbot.collision import Clearances, Obstacle
from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.elastic import elastic_base
from cmbot.planning import held_guardrail, robot_of
from cmbot.robot import ARM_JOINTS, Climber, Robot, Side, load_climbing_robot
from cmbot.scene import (
    Face,
    FootholdFile,
    MountFile,
    Scene,
    StanceFile,
    foothold_face,
    foothold_pose,
    held_member,
)

REACH = 0.9
"""Foot 2 is sought no further from foot 1 than this, m: both legs and their offsets."""
APART = 0.16
"""Feet do not stand on each other, m."""
# Cosine of the angle between the normals of two feet at least.
_SAME_NORMAL = 0.999
# Places this far from the ends of a member are left out, m.
_END_MARGIN_M = 0.04


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate(ShortRepr):
    """A stance, and where the arm's base is in it.

    Attributes
    ----------
    stance : StanceFile
        With the climber's angles.
    root, base : (4, 4)
        Poses of foot 1 and of the arm's base in W.
    climber : (5,), rad
    at_origin : bool
        Whether it is that of a scene without ``guardrail.stance``: foot 1 holds at the origin of W.
    """

    stance: StanceFile
    root: FloatArray
    base: FloatArray
    climber: FloatArray
    at_origin: bool = False

    @property
    def place(self) -> str:
        """Where the feet hold, in words."""
        return " and ".join(place.in_words for place in self.stance.held)

    @property
    def feet(self) -> tuple[Side, ...]:
        """The feet that hold."""
        return (1,) if self.stance.foot_2 is None else (1, 2)

    def foot_pose(self, foot: Side) -> FloatArray:
        """Return the pose (4, 4) of a foot in W."""
        return self.root if foot == 1 else np.asarray(self.root @ Climber().poses(self.climber)[0])

    @property
    def in_file(self) -> StanceFile | None:
        """What `guardrail.stance` of a scene file has; None: nothing."""
        return None if self.at_origin else self.stance


@dataclass(frozen=True, kw_only=True, eq=False)
class MountCandidate(ShortRepr):
    """A mount of an arm that has no feet.

    Attributes
    ----------
    name : str
        Of the entry of ``mounts:``.
    mount : MountFile or None
        None: as the scene has it.
    base : (4, 4)
        Pose of the arm's base frame in W.
    stiffness : (6, 6) or None
        Of what it stands on, at its origin along the axes of W; None: rigid.
    """

    name: str
    mount: MountFile | None
    base: FloatArray
    stiffness: FloatArray | None
    feet: tuple[Side, ...] = (1,)  # what is held counts as one

    @property
    def place(self) -> str:
        """Where the base frame is, in words."""
        x, y, z = self.base[:3, 3]
        return f"{self.name} at ({x:.2f}, {y:.2f}, {z:.2f}) m"

    @property
    def root(self) -> FloatArray:
        """Pose of what is loaded, (4, 4), in W: that of the base frame."""
        return self.base


AnyCandidate = Candidate | MountCandidate


def mounts_of(scene: Scene) -> Iterator[MountCandidate]:
    """Yield the mounts of a scene, that of its robot first; of several in one pose the first one counts."""
    robot = robot_of(scene)
    placement = robot.base_pose
    own = elastic_base(held_guardrail(scene, robot))
    stiffness = None
    if own is not None:
        away = _motion(np.array(robot.foot_point) - placement.translation)
        stiffness = away.T @ own.stiffness @ away
    yield MountCandidate(name="own", mount=None, base=placement.homogeneous, stiffness=stiffness)
    known = {tuple(placement.homogeneous.round(9).ravel().tolist())}
    for mounts in scene.mounts:
        for mount in mounts.each:
            key = tuple(mount.matrix.round(9).ravel().tolist())
            if key not in known:
                known.add(key)
                rows = None if mounts.stiffness is None else np.array(mounts.stiffness)
                yield MountCandidate(name=mounts.name, mount=mount, base=mount.matrix, stiffness=rows)


def stiffness_in_world(candidate: MountCandidate) -> FloatArray | None:
    """Return the stiffness (6, 6) of what a mount stands on at the origin of W; None: rigid."""
    if candidate.stiffness is None:
        return None
    away = _motion(candidate.base[:3, 3])
    return np.asarray(away.T @ candidate.stiffness @ away)


def _motion(by: FloatArray) -> FloatArray:
    """Motion (6, 6) of a point by that of another one, from which it is away `by` (3,)."""
    motion = np.eye(6)
    motion[:3, 3:] = np.cross(by, np.eye(3))
    return motion


def own_candidate(scene: Scene) -> Candidate | None:
    """Return the stance in which a scene has its robot; None where its foot holds no member."""
    climber, file = Climber(), scene.guardrail.stance
    if file is None or scene.stance is None:
        member = held_member(scene.elastic_guardrail)
        if member is None:
            return None
        place = FootholdFile(member=member, along_m=0.0)
        along = max(float(-foothold_face(scene.elastic_guardrail, place).ends[0]), 0.0)
        place = place.changed(along_m=along)
        return replace(candidate_at(place, None, np.eye(4), climber.working, climber), at_origin=True)
    stance = scene.stance
    return candidate_at(*file.places, stance.root, np.array(stance.climber), climber)


def candidates_of(
    scene: Scene,
    spacing: float,
    pair_spacing: float,
    members: Collection[str] = (),
    first: Sequence[Candidate] = (),
) -> Iterator[Candidate]:
    """Yield the stances of the shipped robot on a scene's guardrail.

    Round bars are left out where the feet are magnets or welded, and so are stances in which the base is
    on the track's side of foot 1's member. Of stances in which plates and base are where they are in another
    one, as a foot may be turned by half a turn, the first one counts.

    Parameters
    ----------
    scene : Scene
    spacing : float, m
        Between places of foot 1 alone, along members.
    pair_spacing : float, m
        Between places of both feet; infinite: foot 2 stays free.
    members : collection of str
        Those that feet hold; empty: all.
    first : sequence of Candidate
        Stances that come before all others, where they are on these members.
    """
    climber = Climber()
    known = set[tuple[float, ...]]()
    for candidate in first:
        held, other = candidate.stance.held, candidate.stance.foot_2
        X_2 = None if other is None else foothold_pose(scene.elastic_guardrail, other)
        on_them = not members or all(place.member in members for place in held)
        if on_them and _is_new(candidate, X_2, known):
            yield candidate
    for place in places_of(scene, spacing, members):
        X = foothold_pose(scene.elastic_guardrail, place)
        angles = climber.hanging(X[:3, :3])
        if angles is None:
            continue
        candidate = candidate_at(place, None, X, angles, climber)
        if _is_new(candidate, None, known):
            yield candidate
    if not np.isfinite(pair_spacing):
        return
    places = [*places_of(scene, pair_spacing, members)]
    others = [place for place in places if place.turn_deg == places[0].turn_deg]
    for candidate in on_two_feet(scene, places, others, climber):
        if _is_new(candidate, foothold_pose(scene.elastic_guardrail, candidate.stance.held[1]), known):
            yield candidate


def on_two_feet(
    scene: Scene, places: Sequence[FootholdFile], others: Sequence[FootholdFile], climber: Climber
) -> Iterator[Candidate]:
    """Yield the stances with foot 1 at some places and foot 2 at others, the base on the members' outer side.

    Parameters
    ----------
    scene : Scene
    places, others : sequence of FootholdFile
    climber : Climber
    """
    poses, ends = (
        [foothold_pose(scene.elastic_guardrail, place) for place in part] for part in (places, others)
    )
    points, normals = np.array([X[:3, 3] for X in ends]), np.array([X[:3, 1] for X in ends])
    for place, X in zip(places, poses, strict=True):
        away = np.linalg.norm(points - X[:3, 3], axis=1)
        near = (away >= APART) & (away <= REACH) & (normals @ X[:3, 1] > _SAME_NORMAL)
        for k in np.flatnonzero(near).tolist():
            for angles in climber.reaching(np.linalg.inv(X) @ ends[k]):
                candidate = candidate_at(place, others[k], X, angles, climber)
                if (candidate.base[:3, 3] - X[:3, 3]) @ X[:3, 1] > 0:
                    yield candidate


def _is_new(candidate: Candidate, X_2: FloatArray | None, known: set[tuple[float, ...]]) -> bool:
    """Whether plates and base are elsewhere than in those known; with a foot turned by half they are not."""
    feet = [candidate.root] if X_2 is None else [candidate.root, X_2]
    parts = (candidate.base.ravel(), *(X[:3, column] for X in feet for column in (1, 3)))
    key = tuple(np.concatenate(parts).round(6).tolist())
    new = key not in known
    known.add(key)
    return new


def has_flat_foot(scene: Scene, candidate: Candidate) -> bool:
    """Whether a foot of a stance is on flat steel: elsewhere no adhesion is defined."""
    faces = (foothold_face(scene.elastic_guardrail, place) for place in candidate.stance.held)
    return any(not face.held_by_clamps_alone for face in faces)


def candidate_at(
    place: FootholdFile, other: FootholdFile | None, X: FloatArray, angles: FloatArray, climber: Climber
) -> Candidate:
    """Return the stance with the feet at two places, the second None where it is free.

    Parameters
    ----------
    place, other : FootholdFile
        Of foot 1 and of foot 2.
    X : (4, 4)
        Pose of foot 1 in W.
    angles : (5,), rad
    climber : Climber
    """
    degrees = tuple(np.degrees(angles).tolist())
    stance = StanceFile(foot_1=place, foot_2=other, climber_deg=degrees)
    return Candidate(stance=stance, root=X, base=X @ climber.poses(angles)[1], climber=angles)


def places_of(scene: Scene, spacing: float, members: Collection[str] = ()) -> Iterator[FootholdFile]:
    """Yield places of a foot along posts and rails, on every side from which a base can hang, both ways up.

    Also on those sides of posts and of rails that the scene's own feet hold. Where an obstacle or another
    member is in the way of the foot there is none: `Scene.in_the_way`.

    Parameters
    ----------
    scene : Scene
    spacing : float, m
    members : collection of str
        On which they are; empty: all.
    """
    clamps = {hold.kind for hold in scene.guardrail.hold or ()} == {"clamp"}
    for probe, side in faces_of(scene, members):
        if side.held_by_clamps_alone and not clamps:
            continue
        low, high = _END_MARGIN_M, side.ends[1] - side.ends[0] - _END_MARGIN_M
        if probe.member.startswith("post_"):
            post = scene.elastic_guardrail.post
            low = post.clamp - post.bottom + _END_MARGIN_M
            high += _END_MARGIN_M - 0.05
        for along in np.arange(low, high + 1e-9, spacing):
            place = probe.changed(along_m=round(float(along), 4))
            if scene.in_the_way(place) is not None:
                continue
            for turn in (0.0, 180.0):
                yield place.changed(turn_deg=turn)


def faces_of(scene: Scene, members: Collection[str] = ()) -> Iterator[tuple[FootholdFile, Face]]:
    """Yield the faces on which places are sought, as places at the beginning of their members."""
    guardrail = scene.elastic_guardrail
    held = () if scene.guardrail.stance is None else scene.guardrail.stance.held
    of_posts, of_rails = dict.fromkeys(("outer", "left", "right")), dict.fromkeys(("outer",))
    for own in held:
        (of_posts if own.member.startswith("post_") else of_rails)[own.face] = None
    posts = [(f"post_{k + 1}", of_posts) for k in range(len(guardrail.post_positions))]
    rails = [(rail.name, of_rails) for rail in guardrail.rails]
    of_members = [each for each in (*posts, *rails) if not members or each[0] in members]
    for member, faces in of_members:
        for face in faces:
            probe = FootholdFile.model_validate({"member": member, "along_m": 0.0, "face": face})
            yield probe, foothold_face(guardrail, probe)


def climber_in_the_way(scene: Scene, candidate: Candidate) -> str | None:
    """Return what of the climber comes too near to what in a stance; None where nothing does.

    Links of the climber may be nearer to each other than the safety margin, but must not touch: it is locked.

    Parameters
    ----------
    scene : Scene
        As `in_world` returns it.
    candidate : Candidate
    """
    climber = bare_climber(candidate.root, scene.all_obstacles, foot_2=2 not in candidate.feet)
    numbers = np.arange(len(climber.pairs))
    distance = climber.distances(candidate.climber[None], np.zeros_like(numbers), numbers)
    own = np.array([pair.self_collision for pair in climber.pairs], dtype=np.bool_)
    spare = distance - np.where(own, 0.0, scene.planner.safety_margin_m)
    if len(spare) == 0 or spare.min() >= 0:
        return None
    pair = climber.pairs[int(spare.argmin())]
    return f"{pair.link} and {pair.other} come too near to each other"


def bare_climber(root: FloatArray, obstacles: Sequence[Obstacle] = (), *, foot_2: bool = True) -> Clearances:
    """Return clearances of the climber without the arm, by the climbing joints (N, 5), foot 1 at `root`.

    Where foot 2 holds something its own shapes do not count.
    """
    X_RW = np.linalg.inv(root)
    placed = [replace(obstacle, X_WO=X_RW @ obstacle.X_WO) for obstacle in obstacles]
    return Clearances(_climber_alone(foot_2=foot_2), placed)


@lru_cache(maxsize=2)
def _climber_alone(*, foot_2: bool) -> Robot:
    """The climber without the arm, foot 1 at the origin: loaded once, obstacles are placed about it."""
    robot = load_climbing_robot(1, np.eye(4), np.zeros(len(ARM_JOINTS)))
    left_out = {"tool"} if foot_2 else {"tool", "foot_2"}
    return without_links(robot, lambda link: link in left_out or link.startswith("link_"))


def without_links(robot: Robot, left_out: Callable[[str], bool]) -> Robot:
    """Return the robot without the collision shapes of some links."""
    shapes, frames = pin.GeometryModel(robot.collision_model), robot.model.frames
    # Each removal moves the shapes behind it.
    names = [str(s.name) for s in shapes.geometryObjects if left_out(str(frames[s.parentFrame].name))]
    for name in names:
        shapes.removeGeometryObject(name)
    return replace(robot, collision_model=shapes)
