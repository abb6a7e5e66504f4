"""Several plans on one page: overlaid in 3-D and in plots, their figures side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import eigvalsh

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.installation import shipped_scenes
from cmbot.common.reading.validation import counted
from cmbot.elastic import Guardrail, elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.planning import Plan, Samples, held_guardrail, hold_use, verdict
from cmbot.simulation import Tracking
from cmbot.views.charts import (
    MOST_SMALL_POINTS,
    ROOM,
    Chart,
    Curve,
    clearance_chart,
    clearance_of,
    deviation_chart,
    deviation_of,
    joint_axes,
    of_joint,
    torque_chart,
    torque_of,
)
from cmbot.views.drawing.meshcat_scene import Command, carrier_commands, obstacle_commands, path_commands
from cmbot.views.page import table
from cmbot.views.replay_data import FRAME_STEP, MOST_POSES, Frames, frame_times, link_names, stage_data
from cmbot.views.report import SHARES, assemble_report, banner, promised_state, section

MOST_PLANS = 6

# With as many the verdicts are folded: the view comes soon.
_MIN_FOLDED_PLANS = 3
# The small plots have room for the shares of two curves.
_MAX_SHARE_CURVES = 2
# Stiffness and masses that differ by less are the same, as a share.
_SAME_SHARE = 1e-3

# The motion that is drawn whole, then the ghosts.
_MOTION_KEYS = ("planned", *(f"plan_{number}" for number in range(2, MOST_PLANS + 1)))


def compare_page(plans: Mapping[str, Plan], trackings: Mapping[str, Tracking | None] | None = None) -> str:
    """Return an HTML page that shows several plans of one arm together, on the clock of their jobs.

    Like `report_page`, it opens no connection and runs only its own two scripts. The surroundings are those
    of the first plan; arms stand on what is their own, and every plan's tool paths are shown.

    Parameters
    ----------
    plans : mapping of str to Plan
        2 to 6 plans by what the page calls them.
    trackings : mapping of str to Tracking, optional
        Of those plans that were simulated: their verdicts say where the bent tool leaves its path.

    Raises
    ------
    InputError
        When there are fewer or more, or their arms differ in links or joints.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    _require_alike(plans)
    tracked, whole = dict(trackings or {}), len(plans) < _MIN_FOLDED_PLANS
    keys = dict(zip(_MOTION_KEYS, plans, strict=False))
    first = next(iter(plans.values()))
    verdicts = []
    if said := unlike(plans):
        verdicts.append(banner("worse", *said, name="Not one arm on one base", unfolded=whole))
    for name, plan in plans.items():
        state, promise = promised_state(plan, tracked.get(name))
        verdicts.append(banner(state, promise, verdict(plan, area=False), name=name, unfolded=whole))
    return assemble_report(
        _data(first, dict(zip(keys, plans.values(), strict=True)), keys),
        title="Plans compared",
        verdict="".join(verdicts),
        cards="".join(_cards(keys, plans, alike=not said)),
        key=_key(keys, plans),
        bending=" hidden",
        shares=SHARES if len(plans) == _MAX_SHARE_CURVES else "",
        sections=section("Figures", table(_rows(plans), ("", *plans)), kind="wide"),
    )


def unlike(plans: Mapping[str, Plan]) -> tuple[str, ...]:
    """Return why figures of plans cannot be compared as they are, and what to do; nothing where they can.

    Of the robot, its tool and what bends. Bases that are held elsewhere are compared as held where the first
    one is: that they are is what the plans differ by.

    Parameters
    ----------
    plans : mapping of str to Plan
        Two or more by what they are called.
    """
    (first, plan), *others = plans.items()
    measured_one = any(each.scene.identified is not None for each in plans.values())
    at = None if measured_one else held_guardrail(plan.scene, plan.robot)
    mine, told = _bending(plan, at), list[str]()
    for name, other in others:
        if found := list(_differences(plan.scene.base_name, mine, _bending(other, at))):
            told.append(f"in {name} {', '.join(found)}")
    if not told:
        return ()
    judge, by = next((each for each in plans.items() if each[1].scene.identified is not None), (first, plan))
    called, moved = next(each for each in plans.items() if each[0] != judge)
    # A plan that was read has its file for a source.
    read, scene = Path(moved.scene.source), by.scene.name
    folder = str(read.parent) if read.suffix == ".json" else called
    command = f"cmbot evaluate {scene if scene in shipped_scenes() else 'SCENE'} --motion {folder}"
    measured = ", which was measured" * (by.scene.identified is not None)
    return (
        f"Beside {first}, {'; '.join(told)}.",
        f"Torque, sag and sway may differ by that alone: {command} judges the motion of {called} by the "
        f"scene of {judge}{measured}.",
    )


def _bending(plan: Plan, at: Guardrail | None) -> ElasticArm:
    """What bends, its base held where another one is, if it can be; what was measured was so where it was."""
    own = held_guardrail(plan.scene, plan.robot)
    if at is not None:
        places = {name: getattr(at, name) for name in ("foot_point", "footholds", "leg_compliance")}
        if at.post_positions:
            # W is at a foot: the first posts are the same one.
            posts = tuple(x - own.post_positions[0] + at.post_positions[0] for x in own.post_positions)
            places["post_positions"] = posts
        with suppress(InputError):
            return elastic_arm(plan.robot, elastic_base(replace(own, **places)))
    return elastic_arm(plan.robot, elastic_base(own))


def _differences(base: str, mine: ElasticArm, other: ElasticArm) -> Iterator[str]:
    """Yield by what an arm differs from mine, beside where it stands."""
    for (name, value), was in zip(_figures(other).items(), _figures(mine).values(), strict=True):
        if not np.allclose(value, was, rtol=_SAME_SHARE, atol=1e-6):
            now, before = (", ".join(f"{x:.4g}" for x in np.atleast_1d(each)) for each in (value, was))
            yield f"{name} is {now} in place of {before}"
    mine_of, other_of = (
        {(*spring, len(at)): arm.stiffness[np.ix_(at, at)] for spring, at in arm.springs.items()}
        for arm in (mine, other)
    )
    for kind, called in (("base", base), ("link", "links"), ("joint", "joints")):
        bends, then = ({each for each in of if each[0] == kind} for of in (other_of, mine_of))
        if bends != then:
            yield f"of the {called} {'something else' if bends else 'nothing'} bends"
            continue
        shares = [eigvalsh(other_of[each], mine_of[each]) for each in bends] or [np.ones(1)]
        by = " to ".join(sorted({f"{least(shares):.3g}" for least in (np.min, np.max)}, key=float))
        if by != "1":
            yield f"the stiffness of the {called} is {by} times as large"


def _figures(arm: ElasticArm) -> dict[str, Any]:
    """What figures rest on beside stiffness and place."""
    robot, moved = arm.robot, np.zeros((6, 6)) if arm.base is None else arm.base.mass
    return {
        "the payload, kg,": robot.payload,
        "the arm's mass, kg,": robot.arm_mass - robot.payload,
        "its reach, m,": robot.reach,
        "the tool point on its link, m,": robot.model.frames[robot.tool_frame_id].placement.translation,
        "the process force, N,": robot.tool_force,
        "the damping ratio": robot.damping_ratio,
        "the mass of the base, kg,": np.trace(moved[:3, :3]) / 3,
    }


def _require_alike(plans: Mapping[str, Plan]) -> None:
    if not 2 <= len(plans) <= MOST_PLANS:
        got, expected = counted(len(plans), "plan"), f"2 to {MOST_PLANS} different plans"
        raise InputError("cmbot compare", "", got, expected)
    (first, plan), *others = plans.items()
    for name, other in others:
        if (link_names(other.robot), other.robot.joints) != (link_names(plan.robot), plan.robot.joints):
            got, expected = f"another arm ({other.robot.name})", f"that of {first} ({plan.robot.name})"
            raise InputError("cmbot compare", name, got, expected)


def _data(first: Plan, plans: Mapping[str, Plan], names: Mapping[str, str]) -> dict[str, Any]:
    """Return the page's data: one phase, in which each plan's whole job is a motion."""
    end = max(plan.job.duration for plan in plans.values())
    times = frame_times(0.0, end, max(FRAME_STEP, end * first.robot.dof / MOST_POSES))
    pairs = dict[str, int]()
    frames = {key: Frames(plan, pairs) for key, plan in plans.items()}
    motions = {
        key: frames[key].motion(plan.job_samples[0], plan.job.figures, times, on=_strokes(plan))
        for key, plan in plans.items()
    }
    # Arms that stand elsewhere, or on something else, bring along what carries them.
    carrier = _carrier(first)
    owners = [key for key, plan in plans.items() if _carrier(plan) != carrier]
    drawn = [command for key in owners for command in carrier_commands(plans[key], key)]
    paths = path_commands(first)
    for key, plan in plans.items():
        if path_commands(plan) != paths:
            drawn += path_commands(plan, f"/others/{key}")
    return motions | {
        "motions": list(motions),
        "names": dict(names),
        "title": "Plans compared",
        "feet": {key: list(plan.robot.foot_point) for key, plan in plans.items()},
        "owners": owners,
        **{"start": 0.0, "workStart": 0.0, "workEnd": end, "end": end},
        **{"legTimes": [], "moves": [], "floor": None, "floorName": ""},
        **{"approach": None, "return": None, "rest": None},
        "charts": [chart.data() for chart in _charts(first, plans)],
        "jointCharts": [chart.data(MOST_SMALL_POINTS) for chart in _joint_charts(first, plans)],
        **stage_data(list(plans.values()), list(frames.values()), drawn),
    }


def _carrier(plan: Plan) -> tuple[tuple[float, ...], list[Command]]:
    return tuple(plan.robot.foot_point), carrier_commands(plan, "")


def _strokes(plan: Plan) -> list[tuple[float, float]]:
    return [(segment.begin, segment.end) for segment in plan.job.strokes]


def _charts(first: Plan, plans: Mapping[str, Plan]) -> Iterator[Chart]:
    yield torque_chart(first, _curves(plans, torque_of))
    yield clearance_chart(first, _curves(plans, clearance_of))
    along = [_with_sag(curve, plans[curve.motion]) for curve in _curves(plans, deviation_of, strokes=True)]
    chart = deviation_chart(first, tuple(along))
    highest = max(chart.axis[1], *(ROOM * float(curve.y.max()) for curve in along))
    title = "Tool's distance from its path, at rest with its sag, along the strokes"
    yield replace(chart, title=title, axis=(0.0, highest))


def _with_sag(curve: Curve, plan: Plan) -> Curve:
    """The tool's distance with the modelled sag, where the plan does not compensate it."""
    if plan.compensation is not None or not np.isfinite(plan.bent_offsets[1] or np.inf):
        return curve
    t, off = np.hstack([np.array(each) for each in plan.bent_deviation[1]])
    return replace(curve, y=1e3 * np.interp(curve.t, t, off))


def _joint_charts(first: Plan, plans: Mapping[str, Plan]) -> Iterator[Chart]:
    for of, name, joint, factor in joint_axes(first):
        yield of(_curves(plans, of_joint(name, joint, factor)))


def _curves(
    plans: Mapping[str, Plan], quantity: Callable[[Samples], FloatArray], *, strokes: bool = False
) -> tuple[Curve, ...]:
    """Return a quantity of each plan on its job's clock; the first plan's curve is drawn last."""
    curves = []
    for key, plan in plans.items():
        samples, segments = plan.job_samples
        work = {segment.name for segment in plan.job.strokes}
        kept = np.array([not strokes or name in work for name in segments])
        curves.append(Curve.of_some(key, samples.t, np.asarray(quantity(samples)), kept))
    return tuple(reversed(curves))


def _cards(keys: Mapping[str, str], plans: Mapping[str, Plan], *, alike: bool) -> Iterator[str]:
    """Yield what decides between the plans; of the tool that is its place where they are of one arm alone."""
    base = next(iter(plans.values())).scene.base_name
    cards: tuple[tuple[str, str, Callable[[Plan], float]], ...] = (
        (f"Peak {base} torque, whole job", "Nm", lambda plan: plan.job.figures.peak_guardrail_torque),
        ("Tool within", "mm", lambda plan: plan.accuracy.within_mm if plan.accuracy else np.nan),
        ("Feet use of what safety allows", "%", lambda plan: 100 * (hold_use(plan.job) or np.nan)),
        ("Smallest clearance", "mm", lambda plan: 1e3 * plan.job.figures.min_clearance),
        ("Time of the whole job", "s", lambda plan: plan.job.duration),
    )
    for title, unit, of in cards:
        values = [of(plan) for plan in plans.values()]
        if np.isfinite(values).all():
            ranked = alike or title != "Tool within"
            yield _card(keys, title, unit, values, most=title == "Smallest clearance", ranked=ranked)


def _card(
    keys: Mapping[str, str], title: str, unit: str, values: list[float], *, most: bool, ranked: bool
) -> str:
    """A figure of all plans, where they are `ranked` the best in bold and how far it is ahead of the next."""
    ordered = sorted(values, reverse=most)
    shown, best = [f"{value:.1f}" for value in values], f"{ordered[0]:.1f}"
    ahead = [name for name, text in zip(keys.values(), shown, strict=True) if text == best]
    detail = "the same in all" if ranked else "not ranked: of unlike arms"
    if ranked := ranked and len(ahead) < len(shown):
        by = abs(ordered[0] - ordered[len(ahead)])
        then = " than the next" if len(shown) > len(ahead) + 1 else ""
        detail = f"{', '.join(ahead)}: {by:.1f} {unit} {'more' if most else 'less'}{then}"
    texts = []
    for (key, name), text in zip(keys.items(), shown, strict=True):
        tag = "b" if text == best and ranked else "span"
        texts.append(f'<{tag} class="{key}" title="{escape(name)}">{text}</{tag}>')
    first = f'<article class="card each"><h2>{escape(title)}</h2><p>{" ".join(texts)} {unit}</p>'
    return f"{first}<p>{escape(detail)}</p></article>"


def _key(keys: Mapping[str, str], plans: Mapping[str, Plan]) -> str:
    """Return the colours of the plans and, where their surroundings differ, whose are drawn."""
    named = " ".join(f'<span><i class="swatch {key}"></i>{escape(name)}</span>' for key, name in keys.items())
    (first, plan), *others = plans.items()
    drawn = obstacle_commands(plan.scene)
    if all(obstacle_commands(other.scene) == drawn for _, other in others):
        return named
    return f"{named} (the surroundings are those of {escape(first)})"


def _rows(plans: Mapping[str, Plan]) -> Iterator[tuple[str, ...]]:
    """Yield the figures of all plans, one a row, as far as any has them."""
    figures = [{name: planned for name, *_, planned in plan.rows()} for plan in plans.values()]
    for name in dict.fromkeys(name for each in figures for name in each):
        yield name, *(each.get(name, "-") for each in figures)
