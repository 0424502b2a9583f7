"""Arrays by what they hold, for type hints."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
Float64Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Complex128Array = NDArray[np.complex128]
Int64Array = NDArray[np.int64]
IntArray = NDArray[np.intp]
UInt8Array = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]
