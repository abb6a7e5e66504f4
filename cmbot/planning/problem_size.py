"""Problems that are too large for SLSQP: said before the work begins, not after hours of it.

Its matrices are dense, so an iteration costs the cube of the number of unknowns, and passes of hundreds of
iterations take minutes. The sparse solver's costs grow in proportion to the via-points.
"""

from __future__ import annotations

import importlib.util

from cmbot.common.errors import MissingExtra, SceneError
from cmbot.common.installation import install_command
from cmbot.planning.path.task import task_dimension
from cmbot.planning.solvers import solver_of
from cmbot.robot import Finding
from cmbot.scene import PlannerOptions, Scene
from cmbot.trajectory.spline_space import SUPPORT

__all__ = ["MOST_UNKNOWNS", "oversized", "require_reasonable_size"]

MOST_UNKNOWNS = 3000
"""Of a problem for SLSQP: at these a pass takes one to two minutes, at 4,000 more than three."""


def oversized(scene: Scene, joints: int, options: PlannerOptions) -> Finding | None:
    """Say what is wrong when a scene's problem is too large for the solver that it would be planned with.

    Parameters
    ----------
    scene : Scene
    joints : int
        Of its robot.
    options : PlannerOptions
        In place of the scene's own.
    """
    try:
        solver = solver_of(options)
    except MissingExtra:
        return None
    slides = max(joints - task_dimension(scene.keep), 0) if options.knots == "sliding" else 0
    # As many numbers a joint as `SplineSpace.dimension` says, and the slides.
    unknowns = (scene.via_points - SUPPORT) * joints + scene.via_points * slides
    if solver == "sqp" or unknowns <= MOST_UNKNOWNS:
        return None
    most = (MOST_UNKNOWNS + SUPPORT * joints) // (joints + slides)
    installed = importlib.util.find_spec("piqp") is not None
    how = "" if installed else f" ({install_command('fast')})"
    return Finding(
        severity="warning",
        key="tool_path.via_points",
        got=f"{scene.via_points} with solver: slsqp, whose time grows with the cube of their number",
        expected=f"at most {most}, or planner.solver: sqp{how}, whose time grows in proportion",
    )


def require_reasonable_size(scene: Scene, joints: int, options: PlannerOptions) -> None:
    """Refuse a scene that SLSQP would work at for hours.

    Raises
    ------
    SceneError
        With what to do about it.
    """
    found = oversized(scene, joints, options)
    if found is not None:
        raise SceneError(scene.source, found.key, found.got, found.expected)
