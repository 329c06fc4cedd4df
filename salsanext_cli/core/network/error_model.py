# SPDX-License-Identifier: MIT
"""Model of the probability that a label is wrong: a small network in the card of weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.records import Float
from salsanext_cli.core.texts import shortened

TEMPERATURES = (1e-3, 1e3)
"""Lowest and highest; beyond, the logits of float32 overflow or all classes become equal."""
BLOCK = 256  # Rows computed together: layers of 16 values fit the first cache


def valid_temperature(value: Any) -> float:
    """Return the temperature of a softmax; anything else raises `ValueError`."""
    lowest, highest = TEMPERATURES
    if type(value) not in (int, float) or not lowest <= value <= highest:
        raise ValueError(f"temperature {shortened(value)} is not in {lowest:g}…{highest:g}")
    return float(value)


def last_values(rows: Float, layers: Sequence[tuple[Float, Float]]) -> Float:
    """Return the last value of an `ErrorModel` for rows of features.

    Parameters
    ----------
    rows : (N, F) float32
        Features.
    layers : sequence of pairs
        Weights (I, O) and biases (O,) of each layer.

    Returns
    -------
    (N,) float32
        Values; NaN for rows with NaN.
    """
    rows = argument(rows, np.float32)
    arrays = tuple((argument(w, np.float32), argument(b, np.float32)) for w, b in layers)
    values = np.empty(len(rows), np.float32)

    def compute(numbers: slice) -> None:
        compute_rows(rows[numbers], arrays, values[numbers])

    parallel_for_slices(compute, len(rows))
    return values


@compiled
def compute_rows(rows: Float, layers: tuple[tuple[Float, Float], ...], last: Float) -> None:
    """Write the result of `last_values`, block by block.

    Parameters
    ----------
    rows : (N, F) float32
        Features.
    layers : tuple of pairs
        Weights (I, O) and biases (O,) of each layer.
    last : (N,) float32
        Result.
    """
    widest = rows.shape[1]
    for _, bias in layers:
        widest = max(widest, len(bias))
    before = np.zeros((widest, BLOCK), np.float32)
    after = np.zeros((widest, BLOCK), np.float32)
    for start in range(0, len(rows), BLOCK):
        count = min(BLOCK, len(rows) - start)
        for i in range(count):
            for k in range(rows.shape[1]):
                before[k, i] = rows[start + i, k]
        for number, (weight, bias) in enumerate(layers):
            for j in range(len(bias)):
                values = after[j]
                values[:] = bias[j]
                for k in range(len(weight)):
                    factor = weight[k, j]
                    column = before[k]
                    for i in range(BLOCK):
                        values[i] += factor * column[i]
                if number < len(layers) - 1:
                    for i in range(BLOCK):
                        # Not `max`: NaN stays.
                        if values[i] < 0:
                            values[i] = 0
            before, after = after, before
        last[start : start + count] = before[0, :count]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ErrorModel:
    """Perceptron whose last value is the logit of the probability that a label is wrong."""

    features: tuple[str, ...]  # Names of the F features, in order
    # Weights and biases, float32, from F values to one; between layers, negative values become 0
    layers: Sequence[tuple[Float, Float]]
    scores: Mapping[str, Any] = field(default_factory=dict)  # On held-out labelled scans
    # Of the softmax that the features describe; None for the temperature of the weights
    temperature: float | None = None

    def __post_init__(self) -> None:
        sizes = [len(self.features)] + [len(bias) for _, bias in self.layers]
        if not self.layers or sizes[-1] != 1:
            raise ValueError("the error model does not have one output")
        for (weight, bias), size in zip(self.layers, pairwise(sizes), strict=True):
            if weight.shape != size or bias.ndim != 1:
                raise ValueError(f"a layer of the error model is {weight.shape}, not {size}")
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError("the error model has values that are not finite")

    def probability(self, features: Float) -> Float:
        """Return the probability of an error, (N,) float32 or NaN, from features (N, F)."""
        if features.shape[1:] != (len(self.features),):
            raise ValueError(f"features of {features.shape}, not of (N, {len(self.features)})")
        # Clipped, because the exponential would overflow.
        logits = np.clip(last_values(features, self.layers), -30, 30)
        return (1 / (1 + np.exp(-logits))).astype(np.float32, copy=False)

    def to_dict(self) -> dict[str, object]:
        """Return plain data that `from_dict` accepts; numbers have seven digits."""
        layers = [[_rounded(weight), _rounded(bias)] for weight, bias in self.layers]
        data = {"features": list(self.features), "layers": layers, "scores": dict(self.scores)}
        if self.temperature:
            data["temperature"] = self.temperature
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ErrorModel:
        """Read the result of `to_dict`; invalid data raise a `ValueError` or the like."""
        layers = [
            (np.array(weight, np.float32), np.array(bias, np.float32))
            for weight, bias in data["layers"]
        ]
        names = tuple(map(str, data["features"]))
        scores = dict(data["scores"])
        temperature = data.get("temperature")
        return cls(
            features=names,
            layers=layers,
            scores=scores,
            temperature=temperature and valid_temperature(temperature),
        )


def _rounded(values: Float) -> Any:
    return np.vectorize(lambda value: float(f"{value:.7g}"), otypes=[object])(values).tolist()
