"""HTML pages that need nothing but a browser: put together from what lies beside this, written as files."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import os
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from html import escape
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.input_files import require_replaceable

STAGE_SCRIPTS = ("stage.js", "marks.js", "beams.js", "bending.js", "colours.js", "motions.js", "player.js")
"""The 3-D view and the time, shared by replay and report."""

_RESOURCES = files("cmbot.views.page")


def assemble(
    template: str, *, styles: Sequence[str], scripts: Sequence[str], data: Any, texts: Mapping[str, str]
) -> str:
    """Return an HTML page that opens no connection and runs two scripts: meshcat's viewer and `scripts`.

    `template`, `styles` and `scripts` name resources. `data`, for the scripts, becomes JSON. `texts` gives
    further fields of the template as HTML, in which text from files is escaped.
    """
    parts = {"viewer": _viewer_script(), "view": _text("view.html"), "controls": _text("controls.html")}
    return assemble_plain(template, styles=styles, scripts=scripts, data=data, texts={**texts, **parts})


def assemble_plain(
    template: str, *, styles: Sequence[str], scripts: Sequence[str], data: Any, texts: Mapping[str, str]
) -> str:
    """Return an HTML page as `assemble` does, without the 3-D viewer."""
    code = "".join(map(_text, scripts))
    page = f"{_text('head.html')}{_text(template)}</body>\n</html>\n"
    return Template(page).substitute(
        texts,
        scripts=code,
        policy=_policy(code, *filter(None, [texts.get("viewer")])),
        style="".join(map(_text, styles)),
        data=_inline_json(data),
    )


def still_page(title: str, sentences: Iterable[str], content: str) -> str:
    """Return an HTML page that opens no connection and runs no script: sentences, below them `content`.

    `content` is HTML, in which text from files is escaped.
    """
    return assemble_plain(
        "still.html",
        styles=("common.css", "overview.css"),
        scripts=(),
        data=None,
        texts={
            "title": escape(title),
            "sentences": "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences),
            "content": content,
        },
    )


def table(rows: Iterable[Sequence[str]], headings: Sequence[str] = ("", ""), *, text_columns: int = 1) -> str:
    """Return a table: columns of text, then columns of numbers; on phones the keyboard scrolls it, too.

    Without rows there is none.
    """
    kinds = ["text" if number < text_columns else "number" for number in range(len(headings))]
    head = "".join(
        f'<th class="{kind}" scope="col">{escape(h)}</th>' if h else "<td></td>"
        for h, kind in zip(headings, kinds, strict=True)
    )
    body = ""
    for row in rows:
        first, *others = (escape(cell) for cell in row)
        cells = (f'<td class="{kind}">{cell}</td>' for cell, kind in zip(others, kinds[1:], strict=True))
        body += f'<tr><th class="text" scope="row">{first}</th>{"".join(cells)}</tr>'
    if not body:
        return ""
    top = f"<thead><tr>{head}</tr></thead>" if any(headings) else ""
    return f'<div class="table" tabindex="0"><table>{top}<tbody>{body}</tbody></table></div>'


def ticks(low: float, high: float, count: int) -> list[float]:
    """Return round numbers from `low` to `high`, about so many."""
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(part * power for part in (1, 2, 5, 10) if part * power >= raw * (1 - 1e-9))
    each = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)
    return [float(f"{value:.6g}") + 0.0 for value in each * step]


def write_page(path: Path, text: str) -> None:
    """Write a page; it appears whole or not at all."""
    with draft_of(path) as draft:
        draft.write_text(text, encoding="utf-8", errors="replace", newline="\n")


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Give the path of an empty file beside `path` that is renamed to it, unless an error is raised.

    Where `path` is a link, what it leads to is replaced.
    """
    if "\0" in str(path):
        raise _cannot_write(path, "embedded null byte")
    require_replaceable(path, InputError)
    place = Path(os.path.realpath(path))
    draft = place.parent / f".{uuid.uuid4().hex}{path.suffix}"
    try:
        # Where that cannot be done, no film is made first.
        draft.touch()
        yield draft
        draft.replace(place)
    except OSError as error:
        missing = isinstance(error, FileNotFoundError) and not place.parent.exists()
        why = f"there is no folder {path.parent}" if missing else error.strerror or str(error)
        raise _cannot_write(path, why) from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


def _cannot_write(path: Path, why: str) -> InputError:
    return InputError(
        str(path), "", f"a file that cannot be written ({why})", "a path where a file can be written"
    )


def pack(array: FloatArray) -> str:
    """Return an array for the scripts: little-endian float32 in base64."""
    return base64.b64encode(array.astype("<f4").tobytes()).decode("ascii")


def pack_exactly(array: FloatArray) -> str:
    """Return an array for the scripts: little-endian float64 in base64."""
    return base64.b64encode(array.astype("<f8").tobytes()).decode("ascii")


def _text(name: str) -> str:
    return (_RESOURCES / name).read_text(encoding="utf-8")


@cache
def _viewer_script() -> str:
    """Meshcat's viewer with the notices that its licences require."""
    folder = Path(str(distribution("meshcat").locate_file("meshcat/viewer")))
    licence, notices, code = (
        (folder / name).read_text(encoding="utf-8")
        for name in ("LICENSE", "dist/main.min.js.LICENSE.txt", "dist/main.min.js")
    )
    script = f"/*! MeshCat\n{licence}*/\n{notices}\n{code}\n"
    return script.replace("\r\n", "\n").replace("</script", r"<\/script").replace("<!--", r"<\!--")


def _policy(*scripts: str) -> str:
    hashes = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:"


def _inline_json(data: Any) -> str:
    """Return JSON that cannot end the script element that contains it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026")
