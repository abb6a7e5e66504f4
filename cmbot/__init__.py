"""Plans the motion of a robot arm on a flexible base.

The reading order::

    load_scene     a scene file, checked                  cmbot.scene
    load_robot     a URDF, checked, its limits            cmbot.robot
    plan           path, trajectory, certificate          cmbot.planning
    Plan           what came out, with its figures
    save, load_plan   a plan directory                    cmbot.archive
    simulate       what bends on the way                  cmbot.simulation
    identify       how stiff it is, from measurements     cmbot.identification
    walk, tour     the steps from one stance to another, and the work in each   cmbot.walking
    replay, report, show   the motion in a browser or a notebook, and what it gains   cmbot.views
    campaign       many scenes on many processes          cmbot.campaigns

Names are imported when they are first used, so that ``import cmbot`` is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from cmbot.common.errors import (
    ArchiveError,
    CmbotError,
    InputError,
    LimitViolation,
    MissingExtra,
    ModelError,
    OptimisationFailed,
    PathNotFound,
    PlanningError,
    SceneError,
    SimulationDiverged,
)
from cmbot.version import __version__

if TYPE_CHECKING:
    from cmbot.archive import load_plan, load_tracking, load_walk, save, save_tracking
    from cmbot.campaigns import Campaign, campaign
    from cmbot.identification import Identification, identify
    from cmbot.planning import Plan, QuinticTrajectory, plan
    from cmbot.robot import Robot, load_robot
    from cmbot.scene import PlannerOptions, Scene, load_scene
    from cmbot.simulation import SimulationOptions, Tracking, simulate
    from cmbot.views import plot, replay, report, show
    from cmbot.walking import Tour, Walk, tour, walk

__all__ = [
    "ArchiveError",
    "Campaign",
    "CmbotError",
    "Identification",
    "InputError",
    "LimitViolation",
    "MissingExtra",
    "ModelError",
    "OptimisationFailed",
    "PathNotFound",
    "Plan",
    "PlannerOptions",
    "PlanningError",
    "QuinticTrajectory",
    "Robot",
    "Scene",
    "SceneError",
    "SimulationDiverged",
    "SimulationOptions",
    "Tour",
    "Tracking",
    "Walk",
    "__version__",
    "campaign",
    "identify",
    "load_plan",
    "load_robot",
    "load_scene",
    "load_tracking",
    "load_walk",
    "plan",
    "plot",
    "replay",
    "report",
    "save",
    "save_tracking",
    "show",
    "simulate",
    "tour",
    "walk",
]

_ROOMS = {
    "cmbot.archive": ("load_plan", "load_tracking", "load_walk", "save", "save_tracking"),
    "cmbot.campaigns": ("Campaign", "campaign"),
    "cmbot.identification": ("Identification", "identify"),
    "cmbot.planning": ("Plan", "QuinticTrajectory", "plan"),
    "cmbot.robot": ("Robot", "load_robot"),
    "cmbot.scene": ("PlannerOptions", "Scene", "load_scene"),
    "cmbot.simulation": ("SimulationOptions", "Tracking", "simulate"),
    "cmbot.views": ("plot", "replay", "report", "show"),
    "cmbot.walking": ("Tour", "Walk", "tour", "walk"),
}
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name from its room when it is first asked for."""
    if name not in _ROOM_OF:
        raise AttributeError(f"module 'cmbot' has no attribute {name!r}")
    value = getattr(import_module(_ROOM_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_ROOM_OF})
