"""Keep a plan with everything that there is to see of it: files, replay, report, figures.

Run it with ``python examples/06_report.py``, or with a folder's name to keep what it writes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cmbot

scene = cmbot.load_scene(
    {
        "format": "cmbot-scene/2",
        "name": "stroke",
        "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
        "tool_path": {"legs": [{"by": [0, -0.3, 0], "seconds": 4}], "via_points": 8},
        "planner": {"knots": "fixed"},
    }
)
plan = cmbot.plan(scene)
tracking = cmbot.simulate(plan)

with tempfile.TemporaryDirectory() as name:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else name) / "stroke"
    cmbot.save(plan, folder)
    cmbot.save_tracking(tracking, folder)
    cmbot.replay(plan, html=folder / "replay.html", tracking=tracking)
    cmbot.report(plan, html=folder / "report.html", tracking=tracking)
    try:
        for figure in (*cmbot.plot(plan), *cmbot.plot(tracking)):
            figure.savefig(folder / f"{figure.get_label()}.pdf")
    except cmbot.MissingExtra as error:
        print(error)
    for path in sorted(folder.iterdir()):
        print(f"{path.stat().st_size / 1000:8.0f} kB  {path.name}")

    # Read back, it is the same plan; verify=True would certify it anew.
    again = cmbot.load_plan(folder)
    print(again.summary())
    print(f"tracking errors, too: {cmbot.load_tracking(again, folder) is not None}")
