# SPDX-License-Identifier: MIT
"""Memory does not grow with the number of scans."""

import os
import subprocess
import sys

import pytest
from scans import write_sequence

PEAK = """
import resource, sys
from salsanext_cli.cli.app import app
try:
    app(sys.argv[1:])
except SystemExit as end:
    assert end.code == 0, end.code
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_of(command, scans, out, weights, count):
    """Return the most memory, KiB, that a command over so many scans had."""
    line = [command, scans, out, "--weights", weights, "--limit", count, "-q"]
    words = [sys.executable, "-c", PEAK, *map(str, line)]
    on_cpu = {**os.environ, "CUDA_VISIBLE_DEVICES": ""}
    said = subprocess.run(words, env=on_cpu, check=True, capture_output=True, text=True).stdout
    return int(said.splitlines()[-1])


@pytest.mark.slow
def test_the_peak_of_ten_times_the_scans_is_the_same(tmp_path, weights):
    scans = write_sequence(tmp_path / "drive", ["000000"], count=3000, labels=False) / "velodyne"
    for number in range(1, 2000):
        (scans / f"{number:06d}.bin").symlink_to(scans / "000000.bin")
    few, many = (
        peak_of("predict", scans, tmp_path / f"{count}", weights, count) for count in (200, 2000)
    )
    assert many <= 1.05 * few
