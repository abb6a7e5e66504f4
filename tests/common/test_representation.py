"""Objects of the public API have a repr of some hundred characters, whatever arrays they hold."""

from collections.abc import Iterator
from dataclasses import dataclass, field, is_dataclass

import numpy as np
import pytest

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.common.reading.validation import FileModel
from cmbot.common.representation import LONGEST_REPR, short_repr
from cmbot.planning import Plan, precheck_scene
from cmbot.simulation import Tracking

MOST = 400


def reached(of: object, name: str, depth: int, seen: set[int]) -> Iterator[tuple[str, object]]:
    """Objects of the package that attributes lead to, with the way to each."""
    if id(of) in seen or depth == 0:
        return
    seen.add(id(of))
    if isinstance(of, (tuple, list)):
        for k, each in enumerate(of[:2]):
            yield from reached(each, f"{name}[{k}]", depth, seen)
    elif type(of).__module__.startswith("cmbot"):
        yield name, of
        kept = vars(of) if hasattr(of, "__dict__") else {}
        for key in kept:
            if not key.startswith("_"):
                yield from reached(kept[key], f"{name}.{key}", depth - 1, seen)
        for key in ("work", "figures", "certificate", "strokes", "approach"):
            if not isinstance(of, FileModel) and hasattr(of, key):
                yield from reached(getattr(of, key), f"{name}.{key}", depth - 1, seen)


@pytest.mark.parametrize("fixture", ["triangle_plan", "strokes_plan", "triangle_tracking"])
def test_reprs_are_short(fixture: str, request: pytest.FixtureRequest) -> None:
    given: Plan | Tracking = request.getfixturevalue(fixture)
    found = dict(reached(given, fixture, 6, set()))
    assert len(found) > 10
    long = {name: len(repr(each)) for name, each in found.items() if len(repr(each)) > MOST}
    assert long == {}
    assert not [name for name, each in found.items() if "\n" in repr(each)]


def test_reprs_of_what_is_asked_are_short() -> None:
    for name in ("gusset_plate", "pipe"):
        scene = cmbot.load_scene(name)
        for way, each in reached((scene, precheck_scene(scene)), name, 6, set()):
            assert len(repr(each)) <= MOST, way
    for options in (cmbot.PlannerOptions(), cmbot.SimulationOptions()):
        assert repr(options) == f"{type(options).__name__}()"


@pytest.mark.parametrize("room", ["stances", "stances.walking", "identification", "campaigns"])
def test_what_searches_return_is_short_too(room: str) -> None:
    """Their results take minutes: at least they do not have the repr of a dataclass."""
    kinds = {
        "stances": ("StanceRanking", "StanceResult", "Candidate"),
        "stances.walking": ("Walk", "Step", "Move", "Tour"),
        "identification": ("Identification", "Proposal", "Measurements"),
        "campaigns": ("Campaign",),
    }
    for name in kinds[room]:
        kind = getattr(__import__(f"cmbot.{room}", fromlist=[name]), name)
        assert is_dataclass(kind) and kind.__repr__ is short_repr


@dataclass(frozen=True)
class _Held:
    name: str
    share: float
    rows: FloatArray
    more: tuple[int, ...] = (1, 2)
    others: list[str] = field(default_factory=list)
    inner: object = None

    __repr__ = short_repr


def test_a_field_is_its_value_or_its_size() -> None:
    held = _Held("a", 1 / 3, np.zeros((4, 7)), others=["x" * 50] * 9, inner=ValueError("no"))
    assert repr(held) == (
        "_Held(name='a', share=0.333333, rows=<array 4x7>, others=<9 items>, inner=<ValueError>)"
    )
    assert len(repr(_Held("n" * 900, 0.0, np.zeros(1)))) < LONGEST_REPR
