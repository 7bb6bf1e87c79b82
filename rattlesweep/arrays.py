"""Arrays by what they hold, as type hints name them."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Places = NDArray[np.intp]
Flags = NDArray[np.bool_]
