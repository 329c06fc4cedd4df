# SPDX-License-Identifier: MIT
"""A benchmark of a GPU measures that GPU."""

from dataclasses import replace

import pytest
import torch
from scans import SMALL, make_scan

from salsanext_cli.benchmarking.benchmark import IN_PROCESS, Plan, benchmark
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.storage.point_files import write_bin

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"),
]


def test_both_sides_are_on_the_gpu(tmp_path, weights):
    write_bin(tmp_path / "000000.bin", make_scan())
    sensor = replace(SMALL, height=64, width=512)
    found = benchmark(
        tmp_path, network=NetworkSettings(weights, "cuda", sensor), plan=Plan(IN_PROCESS, rounds=1)
    ).to_dict()
    assert found["machine"]["device"] == torch.cuda.get_device_name()
    # A GPU moves more than a hundred gigabytes a second.
    assert found["ceiling"]["bytes"] > 1e11
    for part in found["parts"]:
        assert part["ratio"]["median"] > 0
        assert part["product"]["device_peak_bytes"] > 0
        assert part["baseline"]["device_peak_bytes"] > 0
