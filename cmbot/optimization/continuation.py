"""How hard the passes of an optimisation try, from a rough way through the charts to the last refinement."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["COARSE", "LIGHTER", "SKETCH", "SMOOTH", "Effort"]


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How hard a pass tries.

    Attributes
    ----------
    stride : int
        Every which sample is looked at for violations.
    most : int
        At most so many violated sites of a constraint are added: many are no longer once others are met.
    smoothing : float
        Weight of the smoothing in multiples of the option's: with few working times a light one lets splines
        swing between them.
    accuracy : float
        Of the solver, relative to the objective, which is about 1.
    iterations : int
        The solver's at most: an early pass need not end before the next one knows more.
    slides_only : bool
        Via-points slide, the spline numbers stay.
    """

    stride: int = 1
    most: int = 400
    smoothing: float
    accuracy: float
    iterations: int
    slides_only: bool = False


# Via-points first slide alone; then all unknowns look for a smooth trajectory, coarsely and on all samples.
SKETCH = Effort(stride=10, most=40, smoothing=1000.0, accuracy=1e-4, iterations=100, slides_only=True)
COARSE = Effort(stride=10, most=40, smoothing=1000.0, accuracy=1e-4, iterations=100)
SMOOTH = Effort(smoothing=1000.0, accuracy=1e-5, iterations=200)
# Only a peak that is not yet low enough is worth giving up smoothness for, and not all at once.
LIGHTER = (
    Effort(smoothing=100.0, accuracy=1e-6, iterations=200),
    Effort(smoothing=10.0, accuracy=1e-7, iterations=200),
    Effort(smoothing=1.0, accuracy=1e-9, iterations=1000),
)
