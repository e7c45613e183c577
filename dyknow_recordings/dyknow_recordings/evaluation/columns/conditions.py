"""Conditions of a `select` over columns."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import COMPARISONS
from dyknow_stream_processing import Condition, condition_test

_EXACT: Final = 1 << 53
"""Integers up to this one are floats, too."""


def satisfied(condition: Condition, column: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return which values satisfy a condition, as the dataflow compares them.

    Raises:
        StreamError: if a value cannot be compared.
    """
    compare, value = COMPARISONS[condition.operator], condition.value
    if type(value) in {int, float} and abs(value) <= _EXACT:  # type: ignore[arg-type]
        # Numpy would compare numbers of 32 bits with what such a number can hold of the value.
        if column.dtype.kind == 'f':
            return np.asarray(compare(column.astype(np.float64), float(value)))
        if type(value) is int and column.dtype.kind in 'iu' and column.dtype != np.uint64:
            return np.asarray(compare(column.astype(np.int64), value))
    return np.array(list(map(condition_test(condition), column.tolist())), np.bool_)
