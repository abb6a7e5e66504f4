"""The replay as one HTML page that needs nothing but a browser."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from cmbot.planning import Plan
from cmbot.views.meshcat_scene import reach, scene_commands
from cmbot.views.replay_data import replay_data

__all__ = ["replay_page"]

_HERE = files("cmbot.views") / "page"


def replay_page(plan: Plan) -> str:
    """Return an HTML page that shows a plan, its approach and its baseline moving, in 3-D.

    It holds meshcat's viewer and all data, opens no connection (its content security policy forbids any), and
    runs no script but its own two. The same plan gives the same page.

    Meshes with more than 24 000 triangles in all are simplified, and so are obstacles above 12 000: a page
    stays below 5 MB.

    Parameters
    ----------
    plan : Plan

    Raises
    ------
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    data = replay_data(plan)
    data["reach"] = reach(plan.robot)
    data["commands"] = [base64.b64encode(command).decode("ascii") for command in scene_commands(plan)]
    own = "".join(_text(name) for name in ("stage.js", "motions.js", "plot.js", "playback.js"))
    scripts = {"viewer": _viewer_script(), "replay": own}
    return Template(_text("replay.html")).substitute(
        scripts,
        title=html.escape(plan.scene.name),
        policy=_policy(*scripts.values()),
        style=_text("replay.css"),
        data=_inline_json(data),
    )


def _text(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")


def _viewer_script() -> str:
    """Meshcat's viewer with the notices that its licences ask for."""
    folder = Path(str(distribution("meshcat").locate_file("meshcat/viewer")))
    dist = folder / "dist"
    licence = (folder / "LICENSE").read_text(encoding="utf-8")
    notices = (dist / "main.min.js.LICENSE.txt").read_text(encoding="utf-8")
    code = (dist / "main.min.js").read_text(encoding="utf-8")
    script = f"/*! MeshCat\n{licence}*/\n{notices}\n{code}\n"
    return script.replace("\r\n", "\n").replace("</script", r"<\/script").replace("<!--", r"<\!--")


def _policy(*scripts: str) -> str:
    hashes = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:"


def _inline_json(data: dict[str, Any]) -> str:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026")
