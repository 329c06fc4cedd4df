# SPDX-License-Identifier: MIT
"""Write the results of a folder as a recording for the Rerun viewer, https://rerun.io.

Install: pip install rerun-sdk
Run: python examples/rerun_recording.py out/ drive.rrd && rerun drive.rrd
"""

import sys
from importlib import import_module
from pathlib import Path

import matplotlib
import numpy as np

import salsanext_cli as sn
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder


def main(out: str, recording: str) -> None:
    rerun = import_module("rerun")
    results = ResultFolder(Path(out))
    chosen, sensor = results.chosen(ResultQuery()), results.provenance.sensor()
    space = chosen.space
    rerun.init("salsanext")
    rerun.save(recording)
    classes = [
        (raw, space.labels[raw], tuple(space.colours[train].tolist()))
        for raw, train in space.learning_map.items()
    ]
    rerun.log("/", rerun.AnnotationContext(classes), static=True)
    for number, file in enumerate(chosen.scans):
        scan = results.read(file, sensor)
        points = scan.scan.points
        rerun.set_time("scan", sequence=number)
        rerun.log("name", rerun.TextDocument(file.name))
        rerun.log("label", rerun.Points3D(points, class_ids=scan.label))
        for kind, values in scan.uncertainty.items():
            share = values / max(float(np.nanmax(values)), 1e-9)
            colours = matplotlib.colormaps["viridis"](share, bytes=True)
            rerun.log(f"uncertainty/{kind}", rerun.Points3D(points, colors=colours))
            rerun.log(f"uncertainty/{kind}", rerun.AnyValues(value=values))


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except ImportError:
        sys.exit("error: rerun: not installed\nhint: pip install rerun-sdk")
    except sn.SalsanextError as error:
        sys.exit(f"error: {error}")
