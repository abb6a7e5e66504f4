"""The page of `cmbot walk`: the steps, and where the feet hold, coloured by what they bear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.stances.walking import Walk, WalkSamples, walk_samples
from cmbot.views.overview.guardrail_map import guardrail_map
from cmbot.views.page import still_page, table


def walk_page(walk: Walk) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Parameters
    ----------
    walk : Walk
    """
    samples = list(walk_samples(walk))
    content = f"<section>{guardrail_map(walk.scene, samples)}</section>"
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
