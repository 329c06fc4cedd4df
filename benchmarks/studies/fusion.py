# SPDX-License-Identifier: MIT
"""Labels of labelled drives, of single scans and fused over the drive, and the cost of `fuse`.

Each drive is the folder of a sequence, with `velodyne/`, `labels/` and maybe `poses.txt`. A line
each:

single, fused     accuracy and mean IoU over the classes present, %
AURC              of the labels of single scans, by 1 − the largest probability → by disagreement
worst class       largest loss of IoU of a class of more than 1000 points, in points
moving            labels of moving points that are right, single → fused, %
computed, given   seconds of `fuse` over those of `predict`, with poses computed and given

Run: python -m benchmarks.studies.fusion FOLDER DRIVE …
     [--label-space benchmarks/studies/nuscenes-five.yaml]
     [--classes benchmarks/studies/five.yaml]
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.commands import salsanext
from salsanext_cli import label_space, read_labels

MIN_POINTS = 1000


def timed(*words: object) -> float:
    """Run a command; return its seconds."""
    start = time.perf_counter()
    salsanext(*words)
    return time.perf_counter() - start


def linked(drive: Path, root: Path) -> Path:
    """Make a sequence of links to scans and labels, without the poses; return its scans."""
    sequence = root / "data/sequences" / drive.name
    sequence.mkdir(parents=True, exist_ok=True)
    for name in ("velodyne", "labels"):
        if not (sequence / name).is_symlink():
            (sequence / name).symlink_to((drive / name).resolve())
    return sequence / "velodyne"


def worst_loss(single: dict[str, Any], fused: dict[str, Any]) -> float:
    """Return the largest loss of IoU of a class with many points."""
    points = np.sum(single["confusion"], axis=1)
    before, after = (
        {c["train_id"]: c for c in each["scores"]["classes"]} for each in (single, fused)
    )
    losses = [
        after[i]["iou"] - before[i]["iou"]
        for i in before
        if points[i] > MIN_POINTS and before[i]["iou"] is not None
    ]
    return 100 * min(losses)


def moving_right(drive: Path, out: Path, space_name: str, classes_name: str) -> float:
    """Return the share of the points with a moving label that are right, NaN without any."""
    space, classes = label_space(space_name), label_space(classes_name)
    moving = [raw for raw, name in space.labels.items() if "moving" in name]
    right = total = 0
    for path in sorted((drive / "labels").glob("*.label")):
        truth = read_labels(path) & np.uint32(0xFFFF)
        chosen = np.isin(truth, moving)
        predicted = read_labels(out / "sequences" / drive.name / "predictions" / path.name)
        same = space.to_train(truth[chosen]) == classes.to_train(predicted[chosen], strict=False)
        right, total = right + int(same.sum()), total + int(chosen.sum())
    return right / total if total else float("nan")


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("drives", type=Path, nargs="+")
    parser.add_argument("--label-space", default="semantic-kitti")
    parser.add_argument("--classes", default="semantic-kitti")
    parser.add_argument("--predict", nargs=argparse.REMAINDER, default=[])
    given = parser.parse_args(words or None)
    judged: tuple[object, ...] = ("--label-space", given.label_space)
    if given.classes != given.label_space:
        judged += ("--classes", given.classes)
    for drive in given.drives:
        root = given.folder / drive.name
        out = root / "single"
        # Each has its own folder, which no earlier run has filled: they are timed.
        predicting = timed("predict", linked(drive, root), out, "--probabilities", *given.predict)
        cost = f"computed {timed('fuse', out, root / 'computed') / predicting:.2f}"
        fused, poses = root / "computed", drive / "poses.txt"
        if poses.exists():
            fused = root / "given"
            words = ("fuse", out, fused, "--poses", poses, "--overwrite")
            cost += f", given {timed(*words) / predicting:.2f}"
        single, after = (salsanext("eval", each, *judged) for each in (out, fused))
        found = [each["scores"] for each in (single, after)]
        scores = [f"{100 * s['accuracy']:.1f} / {100 * s['iou_mean_present']:.1f}" for s in found]
        aurc = [single["uncertainty"][k]["aurc"] for k in ("least_confidence", "disagreement")]
        moving = [
            moving_right(drive, each, given.label_space, given.classes) for each in (out, fused)
        ]
        print(
            f"{drive.name}  single {scores[0]}  fused {scores[1]}"
            f"  AURC {aurc[0]:.4f} → {aurc[1]:.4f}  worst class {worst_loss(single, after):+.1f}"
            f"  moving {100 * moving[0]:.1f} → {100 * moving[1]:.1f}  {cost}",
            flush=True,
        )


if __name__ == "__main__":
    main()
