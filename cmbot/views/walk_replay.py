"""A walk in 3-D: the whole robot on its feet, which are coloured by the share of what they can bear."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, interpolated
from cmbot.common.installation import model_folder
from cmbot.planning import robot_of
from cmbot.robot import ARM_JOINTS, CLIMBING_JOINTS
from cmbot.stances.walking import Walk, WalkSamples, walk_samples
from cmbot.views.drawing.bridge import bridge_of
from cmbot.views.drawing.camera import focus_on, link_corners, link_poses, workpieces
from cmbot.views.drawing.meshcat_scene import bridge_commands, encoded, moving_robot_commands, reach
from cmbot.views.page import STAGE_SCRIPTS, assemble, pack
from cmbot.views.replay_data import MOST_POSES

_MOTION_NAME = "planned"  # the name of the one motion
# Places of a foot that are drawn, and how little it moves from one sample to the next where it stays, m.
_MOST_PLACES, _STAYS = 160, 1e-5
_CAMERA_AZIMUTH = np.pi / 3  # of the camera, rad
_KNOTS = 25  # of each move that the first view is fitted to
_WORKPIECE_DISTANCE_M = 0.5  # of all that moves, within which workpieces are shown, m
_CLIMBER_JOINTS = (*CLIMBING_JOINTS, *ARM_JOINTS)


def walk_replay_page(walk: Walk) -> str:
    """Return an HTML page that shows a walk moving, in 3-D.

    It contains meshcat's viewer and all data; its content security policy forbids every connection and every
    script but its own two. The same walk gives the same page.

    Parameters
    ----------
    walk : Walk
    """
    return assemble(
        "walk.html",
        styles=("common.css", "replay.css"),
        scripts=(*STAGE_SCRIPTS, "walk.js"),
        data=_data(walk),
        texts={"title": escape(f"Walk: {walk.scene.name}")},
    )


def _data(walk: Walk) -> dict[str, Any]:
    """The page's data, ready for JSON: one motion, of all links with a foot as their root, at equal times."""
    body, samples = _Body(), list(walk_samples(walk))
    seconds = walk.seconds
    times = np.linspace(0.0, seconds, max(min(int(seconds / 0.1), MOST_POSES // len(body.links)), 1) + 1)
    root, climber, arm = (_at(times, samples, name) for name in ("root", "climber", "arm"))
    poses, frames = body.poses(root, climber, arm), len(times)
    feet = np.concatenate([part.feet for part in samples])
    robot = robot_of(walk.scene)
    places = poses[..., :3].reshape(-1, 3)
    motions = [(move.robot, move.segment.trajectory.q) for move in walk.moves]
    swept = [link_corners(each, link_poses(each, q[:: max(1, len(q) // _KNOTS)])) for each, q in motions]
    beside = workpieces(walk.scene.all_obstacles, places, _WORKPIECE_DISTANCE_M)
    margin = walk.scene.planner.safety_margin_m
    bridge, ways = bridge_of(walk.scene, motions, margin), [_decimated(feet[:, foot]) for foot in (0, 1)]
    drawn = moving_robot_commands(body.visual, body.urdf, walk.scene, ways, robot.reach)
    motion = {
        "poses": pack(poses),
        "torque": pack(np.zeros((frames, 3))),
        "clearance": pack(np.full(frames, np.nan)),
        "near": pack(np.zeros((frames, 7))),
        "pair": pack(np.full(frames, -1.0)),
        "q": pack(np.hstack([climber, arm])),
        "load": pack(_loads(times, samples, body.links)),
        "tool": pack(poses[:, -1, :3]),
        "peakTorque": 1.0,
        **dict.fromkeys(("u", "hold", "error", "minClearance")),
    }
    return {
        "title": walk.scene.name,
        "robot": robot.name,
        "motions": [_MOTION_NAME],
        "names": {_MOTION_NAME: "walk"},
        **{"start": 0.0, "workStart": 0.0, "workEnd": seconds, "end": seconds},
        "foot": feet[0, 0].tolist(),
        "label": "walk",
        "links": list(body.links),
        "parts": _parts(walk),
        **dict.fromkeys(("approach", "return", "rest", "floor", "bending")),
        "margin": margin,
        _MOTION_NAME: motion,
        **{"pairs": [], "pairJoints": []},
        "focus": focus_on(np.concatenate([places, *swept, *beside]), _CAMERA_AZIMUTH),
        "reach": reach(robot),
        "around": bool(bridge),
        "commands": encoded([*drawn, *bridge_commands(bridge)]),
    }


class _Body:
    """The whole robot with foot 1 as a free root."""

    def __init__(self) -> None:
        self.urdf = str(model_folder() / "urdf" / "cmbot.urdf")
        self.model = pin.buildModelFromUrdf(self.urdf, pin.JointModelFreeFlyer())
        folder = str(model_folder() / "urdf")
        self.visual = pin.buildGeomFromUrdf(self.model, self.urdf, pin.GeometryType.VISUAL, None, folder)
        bodies = [frame for frame in self.model.frames if frame.type == pin.FrameType.BODY]
        joints = range(1, self.model.njoints)
        self.links = [next(str(body.name) for body in bodies if body.parentJoint == k) for k in joints]
        self._at = [self.model.joints[self.model.getJointId(name)].idx_q for name in _CLIMBER_JOINTS]

    def poses(self, root: FloatArray, climber: FloatArray, arm: FloatArray) -> FloatArray:
        """Poses (N, n, 7) of the links in W; `root` (N, 7) are those of foot 1."""
        data, q = self.model.createData(), pin.neutral(self.model)
        found = np.empty((len(root), self.model.njoints - 1, 7))
        for k, angles in enumerate(np.hstack([climber, arm])):
            q[:7], q[self._at] = root[k], angles
            pin.forwardKinematics(self.model, data, q)
            found[k] = [pin.SE3ToXYZQUAT(X) for X in list(data.oMi)[1:]]
        return found


def _at(times: FloatArray, samples: list[WalkSamples], name: str) -> FloatArray:
    """Values of the samples at times (F,): those of the move that is on then."""
    values, begins = [], np.array([part.t[0] for part in samples])
    which = np.searchsorted(begins, times, side="right") - 1
    for k, part in enumerate(samples):
        some, own = times[which == k], getattr(part, name)
        values.append(interpolated(some, part.t, own.reshape(len(part.t), -1)))
    return np.concatenate(values)


def _loads(times: FloatArray, samples: list[WalkSamples], links: list[str]) -> FloatArray:
    """Shares (F, n) of what feet and moving joints can bear; NaN where it is not known."""
    found = np.full((len(times), len(links)), np.nan)
    effort, share = _at(times, samples, "effort"), _at(times, samples, "share")
    for k, link in enumerate(map(link_of, _CLIMBER_JOINTS)):
        if link in links:
            found[:, links.index(link)] = effort[:, k]
    for foot in (1, 2):
        found[:, links.index(f"foot_{foot}")] = share[:, foot - 1]
    return found


def link_of(joint: str) -> str:
    """Return the link that a joint of the shipped robot moves."""
    number = int(joint.rpartition("_")[2])
    climber = ("ankle_1", "leg_1", "leg_2", "ankle_2", "foot_2")
    return climber[number - 1] if joint.startswith("climb") else f"link_{number}"


def _parts(walk: Walk) -> list[list[Any]]:
    """Begin, words and what the feet do of each move."""
    number = {id(move): k for k, step in enumerate(walk.steps, start=1) for move in step.moves}
    words = {"arm": "the arm moves", "lift": "lifts", "swing": "swings", "set": "is set down"}
    parts = list[list[Any]]()
    for move, begin in zip(walk.moves, walk.begins, strict=True):
        step = f"step {number[id(move)]} of {len(walk.steps)}" if id(move) in number else "at the end"
        goes = "" if move.kind == "arm" else f"foot {2 if move.holds == (1,) else 1} "
        # What is said of a foot of which no share is known.
        held = ["holds" if foot in move.holds else "free" for foot in (1, 2)]
        parts.append([begin, f"{step}: {goes}{words[move.kind]}", held])
    return parts


def _decimated(way: FloatArray) -> FloatArray:
    """Places of a foot along its way without those where it stays, at most `_MOST_PLACES`."""
    moved = np.linalg.norm(np.diff(way, axis=0), axis=1) > _STAYS
    way = way[np.concatenate([[True], moved])]
    return np.asarray(way[np.unique(np.linspace(0, len(way) - 1, _MOST_PLACES).astype(int))])
