# SPDX-License-Identifier: MIT
"""Model of the features of known classes, to tell how far others lie from them.

One Gaussian per class with a covariance common to all (Lee et al., NeurIPS 2018, equation 2), of
the features before the logits. It is stored as plain numbers in the card of a weights file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from salsanext_cli.network.error_model import rounded
from salsanext_cli.records import Float


@dataclass(frozen=True, slots=True, eq=False)
class NoveltyModel:
    """Centres of classes among features that are whitened by the covariance within classes.

    Attributes
    ----------
    whitening : (D, D) float32
        Inverse of the lower Cholesky factor of the covariance.
    centres : (K, D) float32
        Mean of each class, whitened.
    scores : mapping
        What is known of the scans that it was fitted to.
    """

    whitening: Float
    centres: Float
    scores: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        size = self.centres.shape[1] if self.centres.ndim == 2 else -1
        if not len(self.centres) or self.whitening.shape != (size, size):
            raise ValueError("a novelty model needs classes and a square matrix of their size")
        if not (np.isfinite(self.whitening).all() and np.isfinite(self.centres).all()):
            raise ValueError("a novelty model holds values that are not finite")

    def distance(self, features: Float) -> Float:
        """Return the Mahalanobis distance to the nearest class, (N,) float32, at least 0.

        Parameters
        ----------
        features : (N, D) float32
        """
        found = np.full(len(features), np.inf, np.float32)
        white = features @ self.whitening.T
        for centre in self.centres:
            np.minimum(found, np.square(white - centre).sum(axis=1), out=found)
        distance: Float = np.sqrt(found)
        return distance

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that `from_dict` accepts; numbers have seven digits."""
        numbers = {"whitening": rounded(self.whitening), "centres": rounded(self.centres)}
        return {**numbers, "scores": dict(self.scores)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> NoveltyModel:
        """Read what `to_dict` returns; anything amiss raises a `ValueError` or the like."""
        whitening, centres = (np.array(data[key], np.float32) for key in ("whitening", "centres"))
        return cls(whitening, centres, dict(data["scores"]))
