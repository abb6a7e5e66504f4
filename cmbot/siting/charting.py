"""Charting: what a stance asks by the planner's own charts, obstacles and joint velocities included."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning import ProgressReporter, build_context, searched
from cmbot.scene import Scene

__all__ = ["Charted", "chart"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Charted:
    """What the charts of all strokes say.

    Attributes
    ----------
    bound : float
        Largest of the strokes' lower bounds at rest, in the objective's unit.
    expected : float
        Largest value, at rest, of the best sequences of postures that the joints can follow.
    begins : (n,), rad
        The first posture of the first stroke's sequence.
    """

    bound: float
    expected: float
    begins: FloatArray


def chart(scene: Scene, limit: float) -> Charted:
    """Chart the strokes of a scene, each for `limit` s at most.

    Raises
    ------
    PathNotFound
        When no sequence of admissible postures leads along a stroke.
    """
    context, found = build_context(scene, scene.planner), list[Charted]()
    for number in range(len(context.strokes)):
        at = context.at_stroke(number, scene, context.posture, 0.0, 0.0)
        search, solution = searched(replace(at, reporter=ProgressReporter(limit=limit)))
        if isinstance(solution, PathNotFound):
            raise solution
        found.append(Charted(bound=search.lower_bound.value, expected=solution.peak, begins=solution.q[0]))
    return Charted(
        bound=max(each.bound for each in found),
        expected=max(each.expected for each in found),
        begins=found[0].begins,
    )
