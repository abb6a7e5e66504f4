"""Plans the motion of a robot arm on a flexible base.

The reading order::

    load_scene     a scene file, checked                  cmbot.scene
    load_robot     a URDF, checked, its limits            cmbot.robot
    plan           path, trajectory, certificate          cmbot.planning
    Plan           what came out, with its figures
    replan         the same after frames moved a little, in a fraction of the time
    save, load_plan   a plan directory                    cmbot.archive
    evaluate       what a motion planned elsewhere does   cmbot.evaluation
    simulate       what bends on the way                  cmbot.simulation
    excite         what shakes it: trains, wind           cmbot.excitation
    identify       how stiff it is, from measurements     cmbot.identification
    locate         where the work is, from touched points   cmbot.identification
    walk, tour     the steps from one stance to another, and the work in each   cmbot.stances.walking
    replay, report, show   the motion in a browser or a notebook, and what it gains   cmbot.views
    campaign       many scenes on many processes          cmbot.campaigns

Names are imported when they are first used, so that ``import cmbot`` is quick.
"""

from __future__ import annotations

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
from cmbot.common.lazy_imports import on_first_use
from cmbot.version import __version__

if TYPE_CHECKING:
    from cmbot.archive import (
        load_excitation,
        load_plan,
        load_tour,
        load_tracking,
        load_walk,
        save,
        save_excitation,
        save_tracking,
    )
    from cmbot.campaigns import Campaign, campaign
    from cmbot.evaluation import Evaluation, evaluate
    from cmbot.excitation import Excitation, excite
    from cmbot.identification import Identification, Location, identify, locate
    from cmbot.planning import Plan, QuinticTrajectory, plan, replan
    from cmbot.robot import Robot, load_robot
    from cmbot.scene import PlannerOptions, Scene, load_scene
    from cmbot.simulation import SimulationOptions, Tracking, simulate
    from cmbot.stances.walking import Tour, Walk, tour, walk
    from cmbot.views import plot, replay, report, show

__all__ = [
    "ArchiveError",
    "Campaign",
    "CmbotError",
    "Evaluation",
    "Excitation",
    "Identification",
    "InputError",
    "LimitViolation",
    "Location",
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
    "evaluate",
    "excite",
    "identify",
    "load_excitation",
    "load_plan",
    "load_robot",
    "load_scene",
    "load_tour",
    "load_tracking",
    "load_walk",
    "locate",
    "plan",
    "plot",
    "replan",
    "replay",
    "report",
    "save",
    "save_excitation",
    "save_tracking",
    "show",
    "simulate",
    "tour",
    "walk",
]

_MODULES = (
    *("archive", "campaigns", "evaluation", "excitation", "identification", "planning"),
    *("robot", "scene", "simulation", "views", "stances"),
)
__getattr__ = on_first_use(__name__, _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
