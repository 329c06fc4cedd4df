# SPDX-License-Identifier: MIT
"""The benchmarks run and print what they say; how fast they are is not tested."""

import runpy
from pathlib import Path

from scans import make_scan

from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.inspect import write_sensor

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


def test_uncertainty_cost(tmp_path, weights, capsys):
    write_bin(tmp_path / "000000.bin", make_scan())
    tiny = Sensor("tiny", 3.0, -25.0, 16, 64, range_noise=0.02, intensity_noise=0.02)
    write_sensor(tmp_path / "tiny.toml", tiny)
    main = runpy.run_path(str(BENCHMARKS / "uncertainty_cost.py"))["main"]
    main(str(tmp_path / "000000.bin"), str(tmp_path / "tiny.toml"), "2", "2", str(weights))
    lines = capsys.readouterr().out.splitlines()
    assert [line[:32].strip() for line in lines] == [
        "one deterministic pass",
        "2 passes of dropout",
        "assumed density filtering",
        "analytic, one pass",
        "dropout and density filtering",
    ]
    assert "1.0 × (1.0 to 1.0)" in lines[0]
    assert all(" s " in line for line in lines)
