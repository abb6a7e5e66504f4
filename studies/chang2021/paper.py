"""What the paper measured (Chang 2021, Section 5, Tables 4 and 5), and what is assumed beside it.

The rows "without" and "with" are in the order that agrees with the paper's own percentages; it prints them
the other way round (docs/errata.md).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chang2021.tables import Row
from cmbot.common.arrays import FloatArray
from cmbot.common.installation import assumptions_file

SOURCE = "Chang et al., Electronics 2021, 10(22), 2793, Section 5"
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisErrors:
    """Mean and standard deviation (3,), m, along x, y and z.

    The paper's axes are those of O0; it does not give their directions.
    """

    mean: FloatArray
    standard_deviation: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperExperiment:
    """One experiment of the paper."""

    scene: str  # name of the shipped scene that began as this one
    title: str
    table: str
    without: AxisErrors  # the optimisation
    planned: AxisErrors
    reductions: FloatArray  # (3,), of the absolute mean, per cent, as the text gives them
    torque_difference: float  # largest one on the guardrail, without less with, Nm

    @property
    def scene_file(self) -> Path:
        """The experiment's scene; it stays as it is where the shipped scene of that name goes on."""
        return Path(__file__).parent / "scenes" / f"chang2021_{self.scene}.yaml"


def _error(mean: tuple[float, float, float], deviation: tuple[float, float, float]) -> AxisErrors:
    """From the paper's millimetres."""
    return AxisErrors(mean=1e-3 * np.array(mean), standard_deviation=1e-3 * np.array(deviation))


PAPER = (
    PaperExperiment(
        scene="triangle",
        title="the triangle along the steel bracket",
        table="Table 4",
        without=_error((-2.44, 11.52, -24.48), (4.21, 16.20, 26.78)),
        planned=_error((-1.22, 3.94, -9.23), (1.28, 3.99, 8.22)),
        reductions=np.array([50.1, 65.8, 62.3]),
        torque_difference=157.2,
    ),
    PaperExperiment(
        scene="line",
        title="the line along the vertical angle steel",
        table="Table 5",
        without=_error((-6.17, -3.93, -5.36), (7.62, 4.63, 7.87)),
        planned=_error((-2.13, -2.03, -2.55), (2.01, 2.26, 3.39)),
        reductions=np.array([65.5, 48.3, 52.4]),
        torque_difference=89.14,
    ),
)
"""Both experiments, in the paper's order."""


@dataclass(frozen=True, kw_only=True)
class AssumptionTable:
    """One table of the assumptions: what, value, provenance, and in most of them why."""

    heading: str
    columns: Row
    rows: tuple[Row, ...]


def assumption_tables() -> tuple[AssumptionTable, ...]:
    """Read every table of ``docs/assumptions.md`` with provenances; of links only the text stays."""
    heading, table, tables = "", [], []
    for line in [*assumptions_file().read_text(encoding="utf-8").splitlines(), ""]:
        if line.startswith("|"):
            table.append(tuple(cell.strip() for cell in _LINK.sub(r"\1", line).strip("|").split("|")))
            continue
        if table and "provenance" in table[0]:
            tables.append(AssumptionTable(heading=heading, columns=table[0], rows=tuple(table[2:])))
        table = []
        if line.startswith("## "):
            heading = line[3:]
    return tuple(tables)
