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

NUSCENES = "0001", "0004"
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


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
    return {
        "scans": str(result["scans"]),
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
    }


def semantickitti(data: Path) -> dict[str, str]:
    """Return the quality on the twelve labelled scans of SemanticKITTI."""
    return quality(data / "semantickitti")


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
        classes = ("--classes", BENCHMARKS / "five.yaml", "--sequences", drive)
        salsanext("predict", data / "drives", f"nuscenes-{drive}", *classes)
        labels = ("--label-space", BENCHMARKS / "nuscenes-five.yaml")
        scores = salsanext("eval", f"nuscenes-{drive}", *labels)["scores"]
        values[f"accuracy_{drive}"] = percent(scores["accuracy"])
        values[f"miou_{drive}"] = percent(scores["iou_mean_present"])
    return values


def guarantee(data: Path) -> dict[str, str]:
    """Choose a threshold on SemanticKITTI; return what it accepts there and on PandaSet."""
    chosen = salsanext(
        "tune", "risk", data / "semantickitti", "safe.safetensors", "--at-most", "10%",
        "--sequences", "00,08,x1,x2", "--overwrite",
    )  # fmt: skip
    values = {"threshold": f"{chosen['threshold']:.2f}"}
    for name, words in {"semantickitti": (), "pandaset": ("--sequences", "002")}.items():
        weights = ("--weights", "safe.safetensors", "--reject", "risk")
        salsanext("predict", data / name, f"safe-{name}", *weights, *words)
        rejection = salsanext("eval", f"safe-{name}")["rejection"]
        accepted, wrong = rejection["accepted"], rejection["wrong"]
        values[f"accepted_{name}"] = percent(accepted / rejection["points"])
        values[f"wrong_{name}"] = percent(wrong / accepted)
        values[f"accepted_wrong_{name}"] = percent(wrong / rejection["points"])
    return values


MEASURES: dict[str, Callable[[Path], dict[str, str]]] = {
    measure.__name__: measure
    for measure in (
        semantickitti, pandaset, simulated, simulated_sensors, nuscenes, guarantee
    )
}  # fmt: skip
