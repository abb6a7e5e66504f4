"""The pages of `cmbot walk` and `cmbot tour`: steps, and where feet hold, coloured by what they bear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import chain

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.reading.validation import counted
from cmbot.planning import Plan
from cmbot.stances import Candidate
from cmbot.stances.walking import Tour, Walk, WalkSamples, walk_samples
from cmbot.views.overview.guardrail_map import Stand, guardrail_map
from cmbot.views.page import still_page, table
from cmbot.views.report import REPORT

_REPLAY_LINK = {"replay": "replay.html"}


def walk_page(walk: Walk) -> str:
    """Return an HTML page that opens no connection and runs no script; a link leads to the replay beside it.

    Parameters
    ----------
    walk : Walk
    """
    samples = list(walk_samples(walk))
    content = f"<p>{_links(_REPLAY_LINK)}</p><section>{guardrail_map(walk.scene, samples)}</section>"
    content += f"<section>{steps_table(walk, samples)}</section>"
    return still_page(f"Walk: {walk.scene.name}", walk.in_words(), content)


def steps_table(walk: Walk, samples: Sequence[WalkSamples]) -> str:
    """Return a table of the steps of a walk, with its samples."""
    largest = {id(part.move): part.share for part in samples}
    rows, begins = [], iter(walk.begins)
    for number, step in enumerate(walk.steps, start=1):
        begin = [next(begins) for _ in step.moves]
        used = _share(*(largest[id(move)] for move in step.moves))
        effort = max(move.segment.figures.limit_use.torque for move in step.moves)
        cells = (str(number), f"foot {step.foot}", *step.places, f"{begin[0]:.1f}", f"{step.seconds:.1f}")
        rows.append((*cells, f"{100 * effort:.0f} %", used))
    if walk.last is not None:
        segment = walk.last.segment
        cells = ("", "arm", "", "the start of the work", f"{walk.begins[-1]:.1f}", f"{segment.duration:.1f}")
        rows.append(
            (*cells, f"{100 * segment.figures.limit_use.torque:.0f} %", _share(largest[id(walk.last)]))
        )
    heads = (
        "step",
        "moves",
        "from",
        "to",
        "begins, s",
        "seconds",
        "effort of joints",
        "share that a foot bears",
    )
    return table(rows, heads, text_columns=4)


def _share(*shares: FloatArray) -> str:
    """The largest share of its bounds that a foot uses; nothing where none is known."""
    largest = max(float(np.nanmax(each, initial=0.0)) for each in shares)
    return f"{100 * largest:.0f} %" if largest > 0 else ""


def tour_page(tour: Tour) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Its links lead to the pages of the parts, in folders of their names beside it.

    Parameters
    ----------
    tour : Tour
    """
    parts = list(tour.parts)
    heads = (
        "part",
        "what",
        "begins, s",
        "seconds",
        "peak torque, Nm",
        "adhesion needed, kN",
        "effort of joints",
    )
    rows = ((name, *_row(part, begin)) for name, begin, part in parts)
    content = f"<section>{table(rows, heads, text_columns=2)}</section>"
    samples = [list(walk_samples(each)) for each in tour.walks]
    stands = [
        Stand(each.candidate, _what(plan), [stroke.task.path.outline() for stroke in plan.strokes])
        for each, plan in zip(tour.works, tour.plans, strict=True)
        if isinstance(each.candidate, Candidate)
    ]
    content += f"<section>{guardrail_map(tour.plans[0].scene, [*chain(*samples)], stands)}</section>"
    for name, _, part in parts:
        pages = {"report": REPORT} if isinstance(part, Plan) else {"walk": "index.html"}
        links = _links({what: f"{name}/{page}" for what, page in (pages | _REPLAY_LINK).items()})
        content += f"<h2>{escape(name)}: {escape(_what(part))}</h2><p>{links}</p>"
        if isinstance(part, Plan):
            each = table(part.rows(), part.headings)
        else:
            said = "".join(f"<p>{escape(sentence)}</p>" for sentence in part.in_words())
            each = said + steps_table(part, samples[tour.walks.index(part)])
        content += f"<section>{each}</section>"
    return still_page(f"Tour: {tour.name}", tour.in_words(), content)


def _links(pages: Mapping[str, str]) -> str:
    return ", ".join(f'<a href="{page}">{what}</a>' for what, page in pages.items())


def _what(part: Plan | Walk) -> str:
    if isinstance(part, Plan):
        return ", ".join(str(stroke.name) for stroke in part.scene.strokes)
    return counted(len(part.steps), "step")


def _row(part: Plan | Walk, begin: float) -> tuple[str, ...]:
    if isinstance(part, Plan):
        figures, seconds = part.job.figures, part.job.duration
        torque, needed = f"{figures.peak_guardrail_torque:.1f}", figures.adhesion_needed
        effort = figures.limit_use.torque
    else:
        seconds, needed, effort = part.seconds, part.adhesion_needed, part.effort
        peaks = [move.segment.figures.peak_guardrail_torque for move in part.moves]
        torque = f"{np.max(peaks, initial=0.0):.1f}"
    adhesion = "" if needed is None else f"{needed.peak / 1e3:.2f}"
    return (_what(part), f"{begin:.1f}", f"{seconds:.1f}", torque, adhesion, f"{100 * effort:.0f} %")
