# SPDX-License-Identifier: MIT
"""Fixtures of a SalsaNext of two levels, whose graphs compile in a third of the time."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from scans import salsanext_of, write_weights

SHALLOW = {"context_width": 8, "widths": (8, 16), "decoder_widths": (16,)}

slow_on_openvino = pytest.mark.parametrize(
    "network", ["torch", pytest.param("openvino", marks=pytest.mark.slow)], indirect=True
)
"""Compiling what one test alone needs takes seconds."""


@pytest.fixture(autouse=True, scope="module")
def shallow() -> Iterator[None]:
    """Have two levels and few channels in the network that is called salsanext."""
    with salsanext_of(**SHALLOW):
        yield


@pytest.fixture(scope="module")
def weights(shallow: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors")
