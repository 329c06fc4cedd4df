# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Network and range image that these tests share."""

import pytest
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import load_network, project


@pytest.fixture(scope="module", params=["openvino", "torch"])
def network(weights, request):
    """Return the network on each engine."""
    return load_network(weights, "cpu", engine=request.param)


@pytest.fixture(scope="module")
def image():
    return project(make_scan(), SMALL)
