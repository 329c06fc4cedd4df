# SPDX-License-Identifier: MIT
"""What a stage requests of the labelling of scans."""

from dataclasses import dataclass

from salsanext_cli.core.geometry.knn_parameters import KnnParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelRequest:
    """Results of a scan besides its labels and their least confidence.

    Attributes
    ----------
    knn : KnnParameters
        Neighbourhood of the refinement.
    softmax : bool
        Whether the points have the probabilities of all classes.
    half_softmax : bool
        Whether these are float16, as files contain them, instead of float32.
    error : bool
        Whether the points have the probability that their label is wrong, which needs an error
        model in the weights.
    """

    knn: KnnParameters = KnnParameters()
    softmax: bool = False
    half_softmax: bool = False
    error: bool = False
