# SPDX-License-Identifier: MIT
"""Objects by components of the range image, and by DBSCAN (open3d) on the points of each class.

Labels with instances are the truth; the classes of the points are those of a run of `predict`, and
the true ones, whose range image has 2048 columns. A line each: panoptic quality of cars, of people,
and its mean over the classes of objects present, in %; milliseconds of CPU a scan, median.

Run: python benchmarks/objects.py DATASET OUT, where OUT is of salsanext predict DATASET OUT
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from panoptic import count_segments, panoptic_quality

from salsanext_cli import label_space, project, read_labels, read_scan, sensor
from salsanext_cli.core.geometry.objects import MIN_OBJECT_POINTS, find_objects
from salsanext_cli.core.records import Scan
from salsanext_cli.runs.results.paths import find_scans, output_path
from salsanext_cli.runs.results.result_folder import ResultFolder

EPS_M = (0.3, 0.5, 0.8, 1.2)
CORE_POINTS = 5
SPACE = label_space()
THINGS = SPACE.movable


def dbscan(scan: Scan, _: Any, labels: Any, eps: float) -> Any:
    """Return the number of the object of each point (N,), as `find_objects` does."""
    import open3d

    objects = np.zeros(len(labels), np.uint16)
    for train in np.intersect1d(labels, np.flatnonzero(THINGS)):
        own = np.flatnonzero(labels == train)
        cloud = open3d.geometry.PointCloud(
            open3d.utility.Vector3dVector(scan.points[own].astype(np.float64))
        )
        found = np.asarray(cloud.cluster_dbscan(eps, CORE_POINTS)) + 1
        sizes = np.bincount(found)
        large = sizes >= MIN_OBJECT_POINTS
        large[0] = False
        objects[own] = (large * (np.cumsum(large) + objects.max()))[found]
    return objects


def components(_: Scan, image: Any, labels: Any) -> Any:
    """Return the number of the object of each point (N,)."""
    return find_objects(image, labels, THINGS)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("dataset", type=Path)
    parser.add_argument("out", type=Path)
    given = parser.parse_args(words or None)
    methods: dict[str, Callable[..., Any]] = {"components": components}
    methods |= {f"DBSCAN {eps} m": partial(dbscan, eps=eps) for eps in EPS_M}
    of_run, files = ResultFolder(given.out).sensor(), find_scans(given.dataset)
    for kind, view in (("predicted", of_run), ("true", sensor("hdl64"))):
        counts: dict[str, Any] = dict.fromkeys(methods, 0)
        seconds: dict[str, list[float]] = {name: [] for name in methods}
        for file in files:
            scan, raw = read_scan(file.path), read_labels(file.label_path)
            truth = SPACE.to_train(raw & 0xFFFF)
            path = output_path(given.out, file.sequence, "predictions", file.stem)
            labels = SPACE.to_train(read_labels(path) & 0xFFFF) if kind == "predicted" else truth
            image = project(scan, view)
            for name, method in methods.items():
                method(scan, image, labels)
                start = time.process_time()
                objects = method(scan, image, labels)
                seconds[name].append(time.process_time() - start)
                found = SPACE.to_raw(labels) | objects.astype(np.uint32) << 16
                counts[name] += count_segments((truth, raw), (labels, found), SPACE.scored)
        for name in methods:
            quality = panoptic_quality(counts[name], SPACE, THINGS)
            car, person = (100 * quality["classes"][each]["pq"] for each in ("car", "person"))
            mean = 100 * quality["things_present"]["pq"]
            print(
                f"{kind} classes, {name}  car {car:.1f}  person {person:.1f}  mean {mean:.1f}"
                f"  {1000 * np.median(seconds[name]):.1f} ms",
                flush=True,
            )


if __name__ == "__main__":
    main()
