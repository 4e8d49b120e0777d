"""Types of arrays, by the names that all annotations use."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
AnyArray = NDArray[Any]  # of numbers of any kind, words or records
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]
Indices = NDArray[np.intp]
