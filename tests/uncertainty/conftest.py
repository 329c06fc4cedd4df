# SPDX-License-Identifier: MIT
"""Network and range image that these tests share."""

import pytest
from scans import SMALL, make_scan

from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import load_network


@pytest.fixture(scope="module")
def network(weights):
    return load_network(weights, "cpu")


@pytest.fixture(scope="module")
def image():
    return project(make_scan(), SMALL)
