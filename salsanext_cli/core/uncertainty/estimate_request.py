# SPDX-License-Identifier: MIT
"""What a stage requests of the uncertainty of scans."""

from dataclasses import dataclass

from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.uncertainty.method import UncertaintyMethod


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateRequest:
    """Results of a scan.

    Attributes
    ----------
    method : UncertaintyMethod
        Kinds of uncertainty, and number of passes.
    knn : KnnParameters
        Neighbourhood of the refinement of the labels.
    labels : bool
        Whether the points have the labels of the mean softmax.
    error : bool
        Whether the points have the probability that this label is wrong, which needs an error
        model in the weights.
    """

    method: UncertaintyMethod = UncertaintyMethod()
    knn: KnnParameters = KnnParameters()
    labels: bool = True
    error: bool = False
