# SPDX-License-Identifier: MIT
"""Error models of random numbers."""

from itertools import pairwise

import numpy as np

from salsanext_cli.core.network.error_model import ErrorModel


def layers(*sizes: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return weights and biases of layers between vectors of these sizes."""
    random = np.random.default_rng(len(sizes))
    return [
        (random.normal(size=size).astype("f4"), random.normal(size=size[1]).astype("f4"))
        for size in pairwise(sizes)
    ]


def model() -> ErrorModel:
    """Return a model of three features."""
    return ErrorModel(features=("a", "b", "c"), layers=layers(3, 4, 2, 1), scores={"auroc": 0.9})
