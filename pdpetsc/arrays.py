"""Array aliases. Local indices are int32, global ones and CSR offsets int64."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Float: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
LocalIndex: TypeAlias = NDArray[np.int32]
GlobalIndex: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
