"""Messages of a recording as batches of samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dyknow_common import Alternatives
from dyknow_recordings.reading.columns import MessageColumns
from dyknow_stream_processing import SampleBatch, concatenated, never


def has_alternatives(column: NDArray[np.generic]) -> bool:
    """Return True if a value of a column is one of several alternatives."""
    return column.dtype == np.object_ and Alternatives.are_among(column.tolist())


def batch_of(parts: Sequence[MessageColumns]) -> SampleBatch:
    """Return the messages of a topic in the order of their log times; all have the same fields."""
    stamps = [part.log_times if part.stamps is None else part.stamps for part in parts]
    values = {
        path: _wide(concatenated([part.values[path] for part in parts])) for path in parts[0].values
    }
    log_times = np.concatenate([part.log_times for part in parts])
    batch = SampleBatch(np.concatenate(stamps), values, never, log_times)
    if len(parts) == 1:
        return batch
    return batch.rows(np.argsort(np.concatenate([part.positions for part in parts])))


def _wide(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a column with numbers of 64 bits."""
    if column.dtype.kind == 'f':
        return column.astype(np.float64, copy=False)
    if column.dtype.kind in 'iu' and column.dtype != np.uint64:
        return column.astype(np.int64, copy=False)
    return column
