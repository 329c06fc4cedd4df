# SPDX-License-Identifier: MIT
"""Fixtures of a network of few channels, for tests that ask what is done with a network."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from scans import salsanext_of, write_weights
from world import Stored, World

from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights import loading

NARROW = {"context_width": 16, "widths": (8, 16), "decoder_widths": (16,)}
"""Two levels and few channels: a network of full size would take most of the time of a test."""
narrow_salsanext = partial(salsanext_of, **NARROW)
READ: dict[tuple[str, str], SegmentationNetwork] = {}
"""Networks by the SHA-256 of their file and device: to read one takes half of a short run."""


def read_once(file: Path, device: str, sha256: str) -> SegmentationNetwork:
    """Read the network of a weights file that a test before has not read."""
    if (sha256, device) not in READ or fingerprint(file) != sha256:
        READ[sha256, device] = read_anew(file, device, sha256)
    return READ[sha256, device]


read_anew = loading._read_module


@pytest.fixture(autouse=True, scope="module")
def narrow(full_weights: Path) -> Iterator[None]:  # Written before, since it has all channels
    with narrow_salsanext(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(loading, "_read_module", read_once)
        yield


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with narrow_salsanext():
        return write_weights(tmp_path_factory.mktemp("narrow") / "random.safetensors")


@pytest.fixture(scope="session")
def once_predicted(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> Stored:
    with narrow_salsanext():
        return Stored(tmp_path_factory.mktemp("predicted"), weights, World.predict)


@pytest.fixture
def predicted(once_predicted: Stored) -> World:
    """Return a world with predictions, of which there is one in a session: no other is left."""
    return once_predicted.restored()
