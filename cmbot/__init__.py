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
    ArchiveError as ArchiveError,
    CmbotError as CmbotError,
    InputError as InputError,
    LimitViolation as LimitViolation,
    MissingExtra as MissingExtra,
    ModelError as ModelError,
    OptimisationFailed as OptimisationFailed,
    PathNotFound as PathNotFound,
    PlanningError as PlanningError,
    SceneError as SceneError,
    SimulationDiverged as SimulationDiverged,
)
from cmbot.common.lazy_imports import exported, on_first_use
from cmbot.version import __version__ as __version__

if TYPE_CHECKING:
    from cmbot.archive import (
        load_excitation as load_excitation,
        load_plan as load_plan,
        load_tour as load_tour,
        load_tracking as load_tracking,
        load_walk as load_walk,
        save as save,
        save_excitation as save_excitation,
        save_tracking as save_tracking,
    )
    from cmbot.campaigns import Campaign as Campaign, campaign as campaign
    from cmbot.evaluation import Evaluation as Evaluation, evaluate as evaluate
    from cmbot.excitation import Excitation as Excitation, excite as excite
    from cmbot.identification import (
        Identification as Identification,
        Location as Location,
        identify as identify,
        locate as locate,
    )
    from cmbot.planning import (
        Plan as Plan,
        QuinticTrajectory as QuinticTrajectory,
        plan as plan,
        replan as replan,
    )
    from cmbot.robot import Robot as Robot, load_robot as load_robot
    from cmbot.scene import PlannerOptions as PlannerOptions, Scene as Scene, load_scene as load_scene
    from cmbot.simulation import (
        SimulationOptions as SimulationOptions,
        Tracking as Tracking,
        simulate as simulate,
    )
    from cmbot.stances.walking import Tour as Tour, Walk as Walk, tour as tour, walk as walk
    from cmbot.views import plot as plot, replay as replay, report as report, show as show

_MODULES = (
    *("archive", "campaigns", "evaluation", "excitation", "identification", "planning"),
    *("robot", "scene", "simulation", "views", "stances"),
)
__getattr__ = on_first_use(__name__, _MODULES)
__all__ = [*exported(__name__)]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
