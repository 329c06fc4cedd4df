# SPDX-License-Identifier: MIT
"""The GPU gives the same bits as the CPU."""

import numpy as np
import pytest
import torch

from salsanext_cli.geometry.knn import KnnParameters, knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.sensors import sensor

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"),
]


@pytest.mark.parametrize("width", [2048, 333, 3])
def test_projection_and_knn(rings, width):
    narrow = sensor("hdl64").resized(width=width)
    on_cpu, on_gpu = project(rings, narrow), project(rings, narrow, "cuda")
    for field in ("channels", "pixel_of_point", "point_of_pixel", "point_range"):
        np.testing.assert_array_equal(getattr(on_gpu, field), getattr(on_cpu, field), field)
    labels = np.random.default_rng(2).integers(0, 20, (64, width))
    for parameters in (KnnParameters(), KnnParameters(7, 7, 2.0, 5.0)):
        np.testing.assert_array_equal(
            knn_refine(on_cpu, labels, parameters=parameters, device="cuda"),
            knn_refine(on_cpu, labels, parameters=parameters),
        )
