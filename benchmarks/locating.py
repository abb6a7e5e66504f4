"""Whether what `locate` says of a workpiece is as exact as it claims: simulated touches of one that is known.

    python benchmarks/locating.py [--runs 1000] [--seed 390]

A frame is displaced by draws of its prior, 20 mm and 2 degrees along and about each axis, and its corners,
faces, edges or cylinders are touched with errors of 0.3 mm. *datum* is three places on planes across the
first axis, two across the second and one across the third, *plane* places on six faces in turn. Printed are
the share of the runs in which the truth is in the 95 % region of the estimate, and the median distance that
is left.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot import Scene, load_scene
from cmbot.common.arrays import FloatArray
from cmbot.identification import Feature, Touches, TouchSetup, located

FRAME = {"bracket": {"xyz": [1.8, 0.3, -2.0], "rpy_deg": [10, -20, 30]}}
# 95 % quantile of chi square with six degrees of freedom.
WITHIN = 12.592
_CASES = (
    *(("point", n) for n in (3, 4, 8, 20)),
    ("datum", 6),
    *(("plane", n) for n in (6, 9, 20)),
    ("edge", 6),
    ("cylinder", 9),
)
# On six faces of a box, each with its normal; and its corners.
CORNERS = 0.4 * np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 3)


def features(kind: str, rng: np.random.Generator, count: int) -> list[Feature]:
    """Return features of the box, of one kind."""
    found = list[Feature]()
    for k in range(count):
        axis = np.eye(3)[(0, 0, 0, 1, 1, 2)[k % 6] if kind == "datum" else k % 3] * (1 if k % 2 else -1)
        point = CORNERS[k % len(CORNERS)]
        if kind == "point":
            axis = np.zeros(3)
        elif kind in ("plane", "datum"):
            point = 0.2 * axis + (np.eye(3) - np.outer(axis, axis)) @ rng.uniform(-0.2, 0.2, 3)
        radius = 0.1 if kind == "cylinder" else 0.0
        touched: Any = "plane" if kind == "datum" else kind
        found.append(Feature(kind=touched, point=point, axis=axis, radius=radius))
    return found


def on_feature(feature: Feature, rng: np.random.Generator) -> FloatArray:
    """A place on a feature, in its frame."""
    away = rng.uniform(-0.1, 0.1, 3)
    along = feature.axis * (feature.axis @ away)
    match feature.kind:
        case "plane":
            return feature.point + away - along
        case "edge":
            return feature.point + along
        case "cylinder":
            across = away - along
            return feature.point + along + feature.radius * across / np.linalg.norm(across)
        case _:
            return feature.point


def measured(
    scene: Scene, each: list[Feature], xi: FloatArray, rng: np.random.Generator, noise: float = 3e-4
) -> Touches:
    """Touches of a workpiece that is displaced by `xi`."""
    X = scene.frame_poses["bracket"]
    before = np.array([X[:3, 3] + X[:3, :3] @ on_feature(feature, rng) for feature in each])
    middle = np.mean([X[:3, 3] + X[:3, :3] @ feature.point for feature in each], axis=0)
    places = middle + xi[:3] + (before - middle) @ pin.exp3(xi[3:]).T
    return Touches(
        source="touches",
        scene=scene,
        setup=TouchSetup(touch_sd_mm=0.3),
        frame="bracket",
        X_WF=X,
        places=places + noise * rng.normal(size=places.shape),
        features=tuple(each),
    )


def drawn(rng: np.random.Generator) -> FloatArray:
    """A displacement as the prior has it."""
    return np.concatenate([0.02 * rng.normal(size=3), np.radians(2.0) * rng.normal(size=3)])


def squares(scene: Scene, kind: str, count: int, runs: int, seed: int = 3) -> Iterator[tuple[float, float]]:
    """Squared errors of many estimates in units of their covariance, and what is left of places, m."""
    rng = np.random.default_rng(seed)
    for _ in range(runs):
        xi = drawn(rng)
        found = located(measured(scene, features(kind, rng, count), xi, rng))
        off = found.moved - xi
        yield float(off @ np.linalg.solve(found.covariance, off)), float(np.linalg.norm(off[:3]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=390)
    options = parser.parse_args()
    scene = load_scene("triangle").changed(frames=FRAME)
    print("| touched | inside, % | left, mm |\n|---|---|---|")
    for kind, count in _CASES:
        square, left = np.array(list(squares(scene, kind, count, options.runs, options.seed))).T
        print(
            f"| {count} {kind}s | {100 * (square < WITHIN).mean():.1f} | {1e3 * np.median(left):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
