# SPDX-License-Identifier: MIT
"""Fit a sensor to a folder of scans, write it to a file, and label the scans with it.

Run: python examples/own_sensor.py my/scans out/ [weights.safetensors]
"""

import sys
from pathlib import Path

from salsanext_cli.commands.stages.inspect import inspect, write_sensor
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.io.sensors import sensor
from salsanext_cli.runs.network_settings import NetworkSettings

HEIGHT, WIDTH = 32, 512


def main(scans: str, out: str, weights: str | None = None) -> None:
    survey = inspect(Path(scans), sensor=sensor("hdl64").resized(HEIGHT, WIDTH))
    mine = survey.fitted_sensor("mine")
    write_sensor(Path(out) / "mine.toml", mine)
    print(f"{survey.total.scans} scans, {mine.fov_up:+.1f}° to {mine.fov_down:+.1f}°")

    choice = NetworkSettings(Path(weights) if weights else None, sensor=mine)
    outcome = predict_scans(Path(scans), Path(out), settings=choice)
    for failure in outcome.failures:
        print(failure.text)
    print(f"{outcome.done} done, {outcome.skipped} done already")


if __name__ == "__main__":
    main(*sys.argv[1:])
