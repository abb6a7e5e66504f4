"""What the process of a campaign's job does: it plans a scene and writes a plan directory."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from cmbot.archive import save, save_excitation
from cmbot.common.errors import CmbotError, PlanningError
from cmbot.planning import Plan, baseline_faults, plan, remarks, verdict
from cmbot.scene import load_scene

PLAN_SCENE = f"{__name__}:plan_scene"
"""Name of the function for a `Task`."""


def plan_scene(scene: str, directory: str, *, pages: bool = False) -> dict[str, Any]:
    """Plan a scene and write its plan directory, in place of one that is there.

    Parameters
    ----------
    scene : str
        Content of a scene file with absolute paths, as JSON.
    directory : str
    pages : bool
        Whether replay and report are written, too.

    Returns
    -------
    dict
        JSON data: ``ended``, which is ``planned``, ``no plan`` or ``refused``; the figures of the first, the
        ``reason`` of the others.
    """
    try:
        planned = plan(load_scene(json.loads(scene)))
    except PlanningError as error:
        return {"ended": "no plan", "reason": str(error)}
    except CmbotError as error:
        return {"ended": "refused", "reason": str(error)}
    added = {}
    if pages:
        from cmbot.views import pages as pages_of

        added = pages_of(planned)
    save(planned, directory, force=True, added=added)
    shaken = _shaken(planned, directory) if planned.scene.excitation is not None else {}
    figures = {"planned_work": planned.figures, "planned_job": planned.job.figures}
    if (baseline := planned.baseline) is not None:
        figures |= {"baseline_work": baseline.figures, "baseline_job": baseline.job_figures}
    return {
        "ended": "planned",
        "verdict": verdict(planned),
        "remarks": list(remarks(planned)),
        "duration": planned.job.duration,
        "torque_floor": planned.torque_floor,
        "torque_floor_kind": planned.torque_floor_kind,
        "gap_to_floor": planned.gap_to_floor,
        "planning_seconds": planned.seconds.total,
        **shaken,
        **{name: asdict(each) for name, each in figures.items()},
        # Where a baseline breaks a limit, no gain on it is one.
        "baseline_work_faults": baseline_faults(planned, work=True),
        "baseline_job_faults": baseline_faults(planned),
    }


def _shaken(planned: Plan, directory: str) -> dict[str, Any]:
    """Shake the arm of a plan, as its scene says; write what comes of it, and return its figures."""
    from cmbot.excitation import excite

    excitation = excite(planned)
    save_excitation(excitation, directory, force=True)
    accuracy, times = excitation.accuracy, excitation.timetable
    return {
        "excitation": {
            "rms_mm": excitation.rms_mm,
            "within_mm": None if accuracy is None else accuracy.within_mm,
            "tolerance_share": None if accuracy is None else accuracy.tolerance_share,
            "work_s_per_hour": None if times is None else times.work_s,
        }
    }
