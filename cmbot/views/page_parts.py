"""What every page of ours is put together from: resources, meshcat's viewer, data, a policy."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

__all__ = ["assembled"]

_HERE = files("cmbot.views") / "page"


def assembled(
    template: str, *, styles: Sequence[str], scripts: Sequence[str], data: Any, texts: Mapping[str, str]
) -> str:
    """Return an HTML page that opens no connection and runs no script but its own two.

    Parameters
    ----------
    template : str
        Name of a resource with the fields ``$policy``, ``$style``, ``$view``, ``$controls``,
        ``$data``, ``$viewer``, ``$scripts``, and those of `texts`.
    styles, scripts : sequence of str
        Names of resources, put one behind the other.
    data : object
        For the scripts, as JSON can hold it.
    texts : mapping
        From a field's name to HTML: what comes from a file has to be escaped.
    """
    code = {"viewer": _viewer_script(), "scripts": "".join(map(_text, scripts))}
    return Template(_text(template)).substitute(
        texts,
        **code,
        policy=_policy(*code.values()),
        style="".join(map(_text, styles)),
        view=_text("view.html"),
        controls=_text("controls.html"),
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


def _inline_json(data: Any) -> str:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026")
