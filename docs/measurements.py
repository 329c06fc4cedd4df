# SPDX-License-Identifier: MIT
"""Measure the figures that the guides show, with the default weights, by commands.

A group of figures is a function that returns its values, as the pages show them. docs/figures.json
stores each group with the SHA-256 of the weights and the date.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from labelled_drives import (
    FIVE_CLASSES,
    FIVE_CLASSES_OF_NUSCENES,
    judged_drives,
    linked_semantickitti,
)

NUSCENES = "0001", "0004"
RARE_CLASSES = ("person", "bicyclist", "truck")
"""Classes whose IoU the pages show beside the mean."""


def salsanext(*words: object) -> dict[str, Any]:
    """Run a command in the current folder; return its JSON object."""
    command = [str(Path(sys.executable).with_name("salsanext")), *map(str, words)]
    done = subprocess.run([*command, "--json", "--quiet"], check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


def percent(share: float) -> str:
    """Return a share as per cent with one decimal."""
    return f"{100 * share:.1f}"


def quality(scans: Path, *selection: str) -> dict[str, str]:
    """Return scores, calibration and the ranking of labels of labelled scans."""
    out, coarse = f"out-{scans.name}", f"coarse-{scans.name}"
    salsanext("predict", scans, out, "--probabilities", "--error", *selection)
    salsanext("predict", scans, coarse, "--classes", "coarse", *selection)
    salsanext("eval", out)
    # The file has the risk at each percent of coverage.
    result = json.loads(Path(out, "eval.json").read_text("utf-8"))
    merged = salsanext("eval", coarse)["scores"]
    scores, kinds = result["scores"], result["uncertainty"]
    confidence, error = kinds["least_confidence"], kinds["error"]
    lowest = sum(threshold <= 0.1 for threshold in error["thresholds"])
    drives = result["by_sequence"]
    worst = min(drives, key=lambda name: drives[name]["accuracy"])
    return {
        "scans": str(result["scans"]),
        "drives": str(len(drives)),
        "worst_drive": worst,
        "worst_accuracy": percent(drives[worst]["accuracy"]),
        "worst_miou": percent(drives[worst]["iou_mean_present"]),
        "accuracy": percent(scores["accuracy"]),
        "miou": percent(scores["iou_mean_present"]),
        "wrong": percent(1 - scores["accuracy"]),
        "coarse_accuracy": percent(merged["accuracy"]),
        "coarse_miou": percent(merged["iou_mean_present"]),
        "ece": percent(result["calibration"]["ece"]),
        "error_mean": percent(error["mean"]),
        "error_ece": percent(error["ece"]),
        "auroc_confidence": percent(confidence["auroc"]),
        "auroc_error": percent(error["auroc"]),
        "aurc_confidence": percent(confidence["aurc"]),
        "aurc_error": percent(error["aurc"]),
        "trusted_confidence": percent(confidence["risk_coverage"][79]),
        "trusted_error": percent(error["risk_coverage"][79]),
        "below_tenth": str(lowest),
        "below_tenth_wrong": percent(error["risk_coverage"][lowest - 1]),
        **rare_classes(scores),
    }


def rare_classes(scores: dict[str, Any]) -> dict[str, str]:
    """Return the IoU of the rare classes that the labels contain."""
    return {
        f"iou_{row['name']}": percent(row["iou"])
        for row in scores["classes"]
        if row["name"] in RARE_CLASSES and row["points"]
    }


def semantickitti(data: Path) -> dict[str, str]:
    """Return the quality on 27 labelled scans, ten excerpts of drives of SemanticKITTI."""
    drives = linked_semantickitti(data, Path("semantickitti"))
    values = quality(Path("semantickitti"))
    by_drive = json.loads(Path("out-semantickitti/eval.json").read_text("utf-8"))["by_sequence"]
    for name in drives:
        values[f"accuracy_{name.replace('-', '_')}"] = percent(by_drive[name]["accuracy"])
    return values


def estimates(data: Path) -> dict[str, str]:
    """Return how often the interval of the estimated accuracy holds, each drive predicted alone."""
    inside = 0
    withheld = 0
    drives = judged_drives(data, Path("drives"))
    for number, drive in enumerate(drives):
        out = f"out-{number}"
        selection = ("--sequences", drive.sequence)
        run = salsanext("predict", drive.dataset, out, *selection, *drive.classes)
        accuracy = salsanext("eval", out, *drive.labels)["scores"]["accuracy"]
        expected = run["expected_accuracy"]
        interval = expected["interval"]
        print(drive.name, expected, f"measured {accuracy:.3f}", flush=True)
        if interval is None:
            withheld += 1
        elif interval[0] <= accuracy <= interval[1]:
            inside += 1
    return {"drives": str(len(drives)), "inside": str(inside), "withheld": str(withheld)}


def pandaset(data: Path) -> dict[str, str]:
    """Return the quality on the ten scans of PandaSet that training did not see."""
    return quality(data / "pandaset", "--sequences", "002")


def simulated(_: Path) -> dict[str, str]:
    """Return the quality on simulated scenes that training did not see."""
    words = ("--seed", 7, "--train", 4, "--valid", 20, "--scans", 2)
    salsanext("synth", "scenes", *words)
    return quality(Path("scenes"))


def simulated_sensors(_: Path) -> dict[str, str]:
    """Return the quality on simulated scenes seen by random sensors."""
    words = ("--sensor", "random", "--train", 0, "--valid", 10, "--scans", 4, "--spacing", 10)
    salsanext("synth", "sensors", "--seed", 8, *words)
    return quality(Path("sensors"))


def nuscenes(data: Path) -> dict[str, str]:
    """Return the scores of two drives of nuScenes, in five classes."""
    values = {}
    for drive in NUSCENES:
        out = f"nuscenes-{drive}"
        salsanext("predict", data / "drives", out, "--sequences", drive, *FIVE_CLASSES)
        scores = salsanext("eval", out, *FIVE_CLASSES_OF_NUSCENES)["scores"]
        values[f"accuracy_{drive}"] = percent(scores["accuracy"])
        values[f"miou_{drive}"] = percent(scores["iou_mean_present"])
    return values


def guarantee(data: Path) -> dict[str, str]:
    """Choose a threshold on SemanticKITTI; return what it accepts there and on PandaSet."""
    kitti = Path("semantickitti")
    drives = linked_semantickitti(data, kitti)
    selection = ("--sequences", ",".join(drives))
    chosen = salsanext(
        "tune", "risk", kitti, "safe.safetensors", "--at-most", "10%", *selection, "--overwrite"
    )
    values = {"threshold": f"{chosen['threshold']:.2f}"}
    data_sets = {
        "semantickitti": (kitti, *selection),
        "pandaset": (data / "pandaset", "--sequences", "002"),
    }
    for name, (scans, *words) in data_sets.items():
        weights = ("--weights", "safe.safetensors", "--reject", "risk")
        salsanext("predict", scans, f"safe-{name}", *weights, *words)
        rejection = salsanext("eval", f"safe-{name}")["rejection"]
        accepted, wrong = rejection["accepted"], rejection["wrong"]
        values[f"accepted_{name}"] = percent(accepted / rejection["points"])
        values[f"wrong_{name}"] = percent(wrong / accepted)
        values[f"accepted_wrong_{name}"] = percent(wrong / rejection["points"])
    return values


MEASURES: dict[str, Callable[[Path], dict[str, str]]] = {
    measure.__name__: measure
    for measure in (
        semantickitti, pandaset, simulated, simulated_sensors, nuscenes, guarantee, estimates
    )
}  # fmt: skip
