"""How near the formula of holding is to a linear program of contact.

    python benchmarks/holding.py                # 1,000 loads, half without torsion; prints the table
    python benchmarks/holding.py --loads 100 --corners 250

Loads of a plate of 0.15 x 0.075 m with a friction of 0.4: every component is uniform within its range, forces
of 1,000 N along and across and 300 N out of the steel, moments of 100, 200 and 100 Nm; of half of them the
moment about the normal is zero. What presses the plate, the adhesion less the pull, is compared with that of
`contact_lp`; where it is less, with that of finer cells. With ``--corners``, loads that press the plate near
its corners, too: friction of 40 to 100 % of what slides, half of them without torsion, against cells that are
finer.

Below the table: what the linear program needs of the load with the largest ratio where friction and torsion
are 2 % larger. With a centre of pressure near a corner, more pressing moves it inwards, and may lessen the
moment that friction bears: there a hundredth of friction can be worth a tenth of the adhesion.
"""

from __future__ import annotations

import argparse
import multiprocessing

import numpy as np
from contact_lp import POINTS, FloatArray, Plate

from cmbot.hold import Contact, Foot, Holding

__all__ = ["SIZE", "random_loads", "ratios"]

SIZE, FRICTION, SEED = (0.15, 0.075), 0.4, 2021
# Cells along each side where loads are near corners.
_FINE_POINTS = 31
# Largest forces, N, and moments, Nm, of `SIZE`.
_RANGES = np.array([1000.0, 1000.0, 300.0, 100.0, 200.0, 100.0])


def random_loads(size: tuple[float, float], number: int, seed: int) -> FloatArray:
    """Loads (number, 6), the first half without torsion; moments in proportion to the plate's sides."""
    along, across = np.array(size) / SIZE
    ranges = _RANGES * [1, 1, 1, across, along, 0.5 * (along + across)]
    loads = np.random.default_rng(seed).uniform(-1, 1, (number, 6)) * ranges
    loads[: number // 2, 5] = 0.0
    return np.asarray(loads)


def corner_loads(size: tuple[float, float], number: int, seed: int) -> FloatArray:
    """Loads (number, 6) whose centre of pressure would be near a corner with 1,000 N, the torsion small."""
    rng, half = np.random.default_rng(seed), np.array(size) / 2
    e = rng.uniform(0.65, 0.999, (number, 2)) * rng.choice([-1, 1], (number, 2)) * half
    angle, slide = rng.uniform(0, 2 * np.pi, number), FRICTION * rng.uniform(0.4, 1.0, number)
    torsion = np.where(rng.random(number) < 0.5, 0.0, rng.normal(0, 0.1 * half.min(), number))
    columns = [slide * np.cos(angle), slide * np.sin(angle), np.zeros(number), -e[:, 1], e[:, 0], torsion]
    return 1000.0 * np.column_stack(columns)


def ratios(loads: FloatArray, points: int = POINTS) -> FloatArray:
    """What presses the plate by the package over that by the linear program, (N,)."""
    return np.divide(*presses(loads, points))


def presses(loads: FloatArray, points: int = POINTS) -> tuple[FloatArray, FloatArray]:
    """What presses the plate, N, by the package and by the linear program, (N,) each."""
    flat = {"centre": np.zeros(3), "axes": np.eye(3), "share": np.eye(6)}
    contact = Contact.rectangle(*SIZE)
    foot = Foot(kind="magnet", contact=contact, friction=FRICTION, safety=1.0, **flat)
    plate, values = Plate(*SIZE, FRICTION, points), Holding([foot], np.zeros(6)).needed(0, loads)
    with multiprocessing.Pool() as pool:
        exact = np.array(pool.starmap(plate.needed, zip(loads, values, strict=True), chunksize=10))
    return values - loads[:, 2], exact - loads[:, 2]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--loads", type=int, default=1000)
    parser.add_argument("--corners", type=int, default=0)
    parser.add_argument("--seed", type=int, default=SEED)
    asked = parser.parse_args()
    loads = random_loads(SIZE, asked.loads, asked.seed)
    found = ratios(loads)
    # Where few cells ask for more than the package does, more of them say what is needed.
    below = np.flatnonzero(found < 1.0)
    if len(below):
        found[below] = ratios(loads[below], _FINE_POINTS)
    parts = {"without torsion": found[: asked.loads // 2], "with torsion": found[asked.loads // 2 :]}
    if asked.corners:
        parts["near corners"] = ratios(corner_loads(SIZE, asked.corners, asked.seed), _FINE_POINTS)
    print(f"{asked.loads} loads, seed {asked.seed}: adhesion less pull over that of the linear program")
    print("| | loads | least | median | 90 % | largest |")
    for name, part in parts.items():
        figures = [part.min(), *np.quantile(part, [0.5, 0.9]), part.max()]
        print(f"| {name} | {len(part)} | " + " | ".join(f"{figure:.4f}" for figure in figures) + " |")
    k = int(found.argmax())
    both = np.stack([loads[k], loads[k] * (1.02, 1.02, 1, 1, 1, 1.02)])
    package, exact = presses(both)
    print(
        f"Largest: load {k}, {package[0]:.0f} N pressing where {exact[0]:.0f} N are needed, and "
        f"{exact[1]:.0f} N where friction and torsion are 2 % larger"
    )


if __name__ == "__main__":
    main()
