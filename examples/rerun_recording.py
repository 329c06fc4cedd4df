# SPDX-License-Identifier: MIT
"""Write the results of a folder as a recording for the Rerun viewer, https://rerun.io.

Install: pip install rerun-sdk
Run: python examples/rerun_recording.py out/ drive.rrd && rerun drive.rrd
"""

import sys
from importlib import import_module
from pathlib import Path

import matplotlib

from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import ResultFolder


def main(out: str, recording: str) -> None:
    try:
        rerun = import_module("rerun")
    except ImportError:
        sys.exit("error: rerun: not installed\nhint: pip install rerun-sdk")
    results = ResultFolder(Path(out))
    chosen, sensor = results.chosen(ResultQuery()), results.sensor()
    space = chosen.space
    rerun.init("salsanext")
    rerun.save(recording)
    colours = [tuple(space.colours[train].tolist()) for train in space.learning_map.values()]
    classes = zip(space.learning_map, map(space.labels.get, space.learning_map), colours)
    rerun.log("/", rerun.AnnotationContext(list(classes)), static=True)
    for number, file in enumerate(chosen.scans):
        scan = results.read(file, sensor)
        points = scan.scan.points
        rerun.set_time("scan", sequence=number)
        rerun.log("name", rerun.TextDocument(file.name))
        rerun.log("label", rerun.Points3D(points, class_ids=scan.label))
        for kind, values in scan.uncertainty.items():
            share = values / max(float(values.max()), 1e-9)
            rgba = matplotlib.colormaps["viridis"](share, bytes=True)
            rerun.log(f"uncertainty/{kind}", rerun.Points3D(points, colors=rgba))
            rerun.log(f"uncertainty/{kind}", rerun.AnyValues(value=values))


if __name__ == "__main__":
    main(*sys.argv[1:])
