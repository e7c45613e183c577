"""Split conformal prediction for samples that come in blocks.

The errors of forecasts within one flight are alike: its samples are not exchangeable, so the usual
quantile of all scores promises too much. Blocks of time are assumed to be exchangeable instead. The
quantile gives each block the same weight, however many samples it has, and the unknown next block
the weight of one with infinite scores (Dunn, Wasserman and Ramdas, Distribution-Free Prediction
Sets for Two-Layer Hierarchical Models, 2022; Lee, Barber and Willett, Distribution-free inference
with hierarchical data, 2023). Then a sample of a new block is within the bound with at least the
stated probability, whatever the distribution of the scores is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.errors import RecordingError

Floats = NDArray[np.float64]


def least_blocks(coverage: float) -> int:
    """Return the number of blocks below which no finite bound has a coverage."""
    return math.ceil(round(coverage / (1 - coverage), 9))


def block_quantile(scores: Sequence[Floats], coverage: float) -> float:
    """Return the bound that the scores of a new block keep with a probability.

    Args:
        scores: of each block that has some; of shape (n,) each.
        coverage: the probability, above 0 and below 1.

    Raises:
        RecordingError: for too few blocks.
    """
    count = len(scores)
    if count < least_blocks(coverage):
        raise RecordingError(
            f'there are {count} blocks of time to calibrate with, and {coverage:.4g} needs '
            f'{least_blocks(coverage)}; give more recordings, or shorter blocks or horizons'
        )
    values = np.concatenate(scores)
    weights = np.concatenate([np.full(len(each), 1 / len(each)) for each in scores])
    order = np.argsort(values, kind='stable')
    # A rounding error of the sum must not choose a smaller value.
    reached = np.cumsum(weights[order]) >= coverage * (count + 1) + 1e-9
    index = int(np.argmax(reached)) if reached.any() else len(order) - 1
    return float(values[order[index]])
