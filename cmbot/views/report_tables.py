"""The report's tables and cards as HTML; whatever comes from a file is escaped."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from html import escape
from importlib import metadata
from typing import Literal

import numpy as np

from cmbot.planning import Certificate, Plan
from cmbot.simulation import Tracking, tracking_remarks, tracking_rows, tracking_verdict
from cmbot.version import __version__
from cmbot.views.headlines import Headline, certificates, use_of

__all__ = ["cards", "sections"]

_PACKAGES = ("numpy", "scipy", "pin", "coal")

Row = Sequence[str]


def cards(headlines: Iterable[Headline]) -> str:
    """Return the headlines, one card each."""
    return "".join(_card(headline) for headline in headlines)


def sections(plan: Plan, tracking: Tracking | None, remarks: Iterable[str]) -> str:
    """Return everything of a plan that is no picture, a section each."""
    parts = [
        _section("What should be known", _list(remarks), kind="wide"),
        _section("Figures", _table(("", "baseline", "planned"), plan.rows())),
    ]
    bending = list(_bending(plan))
    if bending:
        parts.append(_section("Sag and vibration, as predicted", _table(("", ""), bending)))
    for name, certificate in certificates(plan).items():
        parts.append(_section(f"Certificate of the {name}", _certificate(certificate)))
    if tracking is not None:
        headings = ("mm", "", "x", "y", "z", "norm")
        table = _table(headings, tracking_rows(tracking), text_columns=2)
        parts.append(
            _section(
                "Simulation",
                table + _list([tracking_verdict(plan, tracking), *tracking_remarks(tracking)]),
                kind="long",
            )
        )
    parts += [
        _section("Scene", _table(("", ""), _scene(plan), text_columns=2)),
        _section("Joints", _table(_JOINT_HEADINGS, _joints(plan))),
        _section("Options", _table(("", ""), _options(asdict(plan.options)), text_columns=2)),
        _section("Written with", _table(("", ""), _versions(plan), text_columns=2)),
    ]
    if tracking is not None:
        options = _table(("", ""), _options(asdict(tracking.options)), text_columns=2)
        parts.append(_section("Options of the simulation", options))
    return "".join(parts)


def _card(headline: Headline) -> str:
    before = f'<small><s>{escape(headline.before)}</s> <span aria-hidden="true">→</span></small> '
    return (
        f'<article class="card {headline.state}"><h2>{escape(headline.title)}</h2>'
        f"<p>{before if headline.before else ''}<b>{escape(headline.value)}</b></p>"
        f"<p>{escape(headline.detail)}</p></article>"
    )


def _section(title: str, content: str, *, kind: Literal["", "wide", "long"] = "") -> str:
    """Return a section; a wide one takes both columns, a long one may be parted where a printed page ends."""
    return f'<section class="{f"part {kind}".rstrip()}"><h2>{escape(title)}</h2>{content}</section>'


def _list(sentences: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(sentence)}</li>' for sentence in sentences)}</ul>"


def _table(headings: Row, rows: Iterable[Row], *, text_columns: int = 1) -> str:
    """Return a table; behind its first columns of text stand numbers."""
    kinds = ["text" if number < text_columns else "number" for number in range(len(headings))]
    head = "".join(
        f'<th class="{kind}" scope="col">{escape(h)}</th>' for h, kind in zip(headings, kinds, strict=True)
    )
    body = "".join(f"<tr>{_cells(row, kinds)}</tr>" for row in rows)
    top = f"<thead><tr>{head}</tr></thead>" if any(headings) else ""
    return f'<div class="table"><table>{top}<tbody>{body}</tbody></table></div>'


def _cells(row: Row, kinds: Sequence[str]) -> str:
    first, *others = (escape(cell) for cell in row)
    cells = "".join(f'<td class="{kind}">{cell}</td>' for cell, kind in zip(others, kinds[1:], strict=True))
    return f'<th class="text" scope="row">{first}</th>{cells}'


def _certificate(certificate: Certificate) -> str:
    bound = f"Clearance stays above {1e3 * certificate.clearance_bound:.1f} mm, between samples too."
    headings = ("promise", "at, s", "value", "bound", "unit", "use", "holds")
    return _table(headings, _checks(certificate)) + f"<p>{escape(bound)}</p>"


def _bending(plan: Plan) -> Iterator[Row]:
    """Yield what was done about the sag and about the vibration; nothing where nothing was."""
    done, quiet = plan.compensation, plan.quieting
    if done is not None:
        yield "sag compensated, rounds", str(done.rounds)
        yield "largest shift of the tool from its path for it, mm", f"{1e3 * done.largest_shift:.3f}"
        yield "change of the shift in the last round, mm", f"{1e3 * done.last_change:.3f}"
    if quiet is not None:
        yield "elastic modes brought to rest", str(quiet.modes)
        yield "share of the change for it that was made", f"{100 * quiet.share:.4g} %"
        if len(set(quiet.shares)) > 1:
            whole = f"{quiet.shares.count(1.0)} of {len(quiet.shares)}"
            yield "legs at whose ends all of it was made", whole
            yield "legs at whose ends none of it was made", f"{quiet.shares.count(0.0)}"
        yield "amplitude that they leave at the tool without it, mm", f"{1e3 * quiet.before:.4f}"
        yield "with it, mm", f"{1e3 * quiet.after:.4f}"


def _checks(certificate: Certificate) -> Iterator[Row]:
    for check in certificate.checks:
        yield (
            check.quantity,
            f"{check.time:.2f}",
            f"{check.value:.4g}",
            f"{'≥' if check.at_least else '≤'} {check.bound:.4g}",
            check.unit,
            f"{100 * use_of(check):.1f} %",
            "yes" if check.holds else "NO",
        )


def _scene(plan: Plan) -> Iterator[Row]:
    scene, path, robot = plan.scene, plan.task.path, plan.robot
    yield "name", scene.name
    yield "robot", f"{robot.name}, {robot.dof} joints, {robot.mass:.1f} kg, payload {robot.payload:g} kg"
    yield "posture, deg", _numbers(np.rad2deg(scene.posture), 1)
    yield "kept of the tool", scene.keep
    legs = zip(np.diff(path.corners, axis=0), path.seconds, strict=True)
    for number, (by, seconds) in enumerate(legs, start=1):
        yield f"leg {number}", f"by ({_numbers(by, 3)}) m in {seconds:g} s"
    workpieces = [obstacle.name for obstacle in scene.obstacles if obstacle.workpiece]
    yield "obstacles", ", ".join(obstacle.name for obstacle in scene.obstacles) or "none"
    yield "of these workpieces", ", ".join(workpieces) or "none"


_JOINT_HEADINGS = ("joint", "range, deg", "deg/s", "deg/s²", "deg/s³", "Nm")


def _joints(plan: Plan) -> Iterator[Row]:
    limits = plan.robot.limits
    for i, name in enumerate(plan.robot.joints):
        low, high = np.rad2deg([limits.lower[i], limits.upper[i]])
        rates = (np.rad2deg(bound[i]) for bound in (limits.velocity, limits.acceleration, limits.jerk))
        reach = f"{low:g} to {high:g}" if np.isfinite([low, high]).all() else "unbounded"
        yield name, reach, *(f"{rate:.4g}" for rate in rates), f"{limits.torque[i]:.4g}"


def _options(options: dict[str, object]) -> Iterator[Row]:
    for name, value in options.items():
        yield name, ", ".join(f"{x:g}" for x in value) if isinstance(value, tuple) else str(value)


def _versions(plan: Plan) -> Iterator[Row]:
    yield "cmbot", __version__
    yield "python", platform.python_version()
    for name in _PACKAGES:
        yield name, metadata.version(name)
    yield "scene", plan.scene.content_hash[:16]
    yield "robot", plan.robot.content_hash[:16]


def _numbers(values: Iterable[float], digits: int) -> str:
    # Adding zero turns -0.0 into 0.0.
    return ", ".join(f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)
