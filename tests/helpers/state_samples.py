"""The type of the fixture `random_states`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
StateSamples = Callable[..., tuple[FloatArray, FloatArray, FloatArray]]
