# SPDX-License-Identifier: MIT
"""Scores and uncertainty under bad conditions: the kinds of corruption that Robo3D names.

Fog, wet ground, snow, motion blur, missing beams, crosstalk, incomplete echoes and another sensor
(Kong et al., ICCV 2023) change each scan of a labelled data set in raw ids of SemanticKITTI, in
three severities; `corruption_models.py` has the models, which are not Robo3D's. Points that are
lost lose their labels. Echoes that are none of the scene have label 0: they are in no score, but
what they do to the points around them is. `predict`, `uncertainty` if asked for, and `eval` run on
each corrupted data set, below the folder. Complete cells are not repeated.

Each line has, in %, mean IoU over the classes present, accuracy and ECE of the softmax; of each
kind of uncertainty AUROC as a detector of wrong points / risk at 80 % coverage; of `error`, of
weights that `tune error` fitted, also / its mean / its ECE. Means are over the three severities.

Run: python -m benchmarks.studies.corruptions semantickitti/ folder/
     [--sequences 08 --weights tuned] [--corruptions fog snow --severities 2 --seed 0 --uncertainty]
"""

import argparse
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import salsanext_cli as sn
from benchmarks.commands import salsanext
from benchmarks.studies.corruption_models import LEVELS, CorruptedScan
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.json_files import read_json, write_json
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.weights.card_file import default_weights, read_card
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import data_set_label_space

CLEAN = "clean"
BASELINES, ERROR = ("least_confidence", "softmax_entropy"), "error"
COVERAGE_PERCENT = 80
SEVERITIES = (1, 2, 3)
Shares = dict[str, tuple[float, ...]]


def corrupted(file: ScanFile, kind: str, severity: int, seed: int) -> CorruptedScan:
    """Read a scan and its labels, and corrupt them; its name and the seed determine the noise."""
    scan = sn.read_scan(file.path)
    labels = sn.read_labels(file.label_path, len(scan))
    if scan.intensity.max(initial=0) > 1:
        sys.exit(f"error: {file.path} · intensity above 1 · expected 0 to 1 · divide it")
    if kind == CLEAN:
        return CorruptedScan(scan, labels)
    model, levels = LEVELS[kind]
    name = zlib.crc32(f"{kind}/{file.sequence}/{file.stem}".encode())
    return model(scan, labels, levels[severity], np.random.default_rng([seed, name]))


def write_data_set(root: Path, space: sn.LabelSpace, files: Sequence[ScanFile], *how: Any) -> None:
    """Write a data set of corrupted scans; `how` is what `corrupted` takes."""
    for file in files:
        changed = corrupted(file, *how)
        folder = root / "sequences" / file.sequence
        write_bytes(folder / "velodyne" / f"{file.stem}.bin", encode_bin(changed.scan))
        sn.write_labels(folder / "labels" / f"{file.stem}.label", changed.labels)
    # Last: it says that the data set is complete.
    write_json(root / "labels.yaml", space.to_dict())


def labelled_scans(dataset: Path, sequences: Sequence[str] | None) -> list[ScanFile]:
    """Return the labelled scans, of some sequences only if they are given."""
    found = find_scans(dataset, sequences)
    files = [file for file in found if file.label_path.is_file()]
    if not files:
        sys.exit(f"error: {dataset} · no labels · expected some beside the scans")
    return files


def require_same_settings(folder: Path, settings: dict[str, Any]) -> None:
    """Record the settings in the folder, or stop if it holds results of others."""
    record = folder / "corruptions.json"
    earlier = read_json(record) or settings
    if differing := [key for key in settings if earlier.get(key) != settings[key]]:
        sys.exit(f"error: {record} · other {', '.join(differing)} · give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    write_json(record, settings)


def scored(root: Path, weights: Path, *, uncertainty: bool) -> dict[str, Any]:
    """Predict and evaluate the data set below a root; return what `eval` says."""
    data, out = root / "data", root / "out"
    error = ("--error",) if read_card(weights).error else ()
    salsanext("predict", data, out, "--weights", weights, "--probabilities", *error)
    if uncertainty:
        salsanext("uncertainty", data, out, "--weights", weights)
    return salsanext("eval", out)


def shares(scores: dict[str, Any]) -> Shares:
    """Return the shares of a line by column, from the scores of `eval`."""
    plain, kinds = scores["scores"], scores["uncertainty"]
    found: Shares = {
        "mIoU": (plain["iou_mean_present"],),
        "accuracy": (plain["accuracy"],),
        "ECE": (scores["calibration"]["ece"],),
    }
    others = sorted(kinds.keys() - {*BASELINES}, key=lambda kind: (kind == ERROR, kind))
    for kind in (*BASELINES, *others):
        of_kind = kinds[kind]
        found[kind] = (of_kind["auroc"], of_kind["risk_coverage"][COVERAGE_PERCENT - 1])
        if kind == ERROR:
            found[kind] += (of_kind["mean"], of_kind["ece"])
    return found


def print_line(name: str, found: Shares) -> None:
    """Print the shares of a line in %."""
    cells = (" / ".join(f"{100 * share:.1f}" for share in each) for each in found.values())
    print(f"{name:20}  " + "  ".join(f"{cell:>18}" for cell in cells), flush=True)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("dataset", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sequences", nargs="+")
    parser.add_argument("--weights", type=Path, default=default_weights())
    parser.add_argument("--corruptions", nargs="+", choices=LEVELS, default=[*LEVELS])
    parser.add_argument("--severities", nargs="+", type=int, choices=SEVERITIES, default=SEVERITIES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--uncertainty", action="store_true")
    given = parser.parse_args(words or None)
    files = labelled_scans(given.dataset, given.sequences)
    space = data_set_label_space(given.dataset) or sn.label_space()
    if space.labels.get(40) != "road":
        sys.exit(f"error: {given.dataset} · raw ids of other classes · expected SemanticKITTI's")
    settings = {
        "version": sn.__version__,
        "scans": [str(file.path) for file in files],
        "weights": fingerprint(given.weights),
        "seed": given.seed,
        "uncertainty": given.uncertainty,
    }
    require_same_settings(given.folder, settings)

    def line(name: str, kind: str, severity: int) -> Shares:
        root = given.folder / name.replace(" ", "-")
        scores = read_json(root / "out/eval.json")
        if scores is None:
            if not (root / "data/labels.yaml").exists():
                write_data_set(root / "data", space, files, kind, severity, given.seed)
            scores = scored(root, given.weights, uncertainty=given.uncertainty)
        found = shares(scores)
        if kind == CLEAN:
            print(" " * 20 + "".join(f"  {key:>18}" for key in found))
        print_line(name, found)
        return found

    line(CLEAN, CLEAN, 0)
    for kind in given.corruptions:
        rows = [line(f"{kind} {severity}", kind, severity) for severity in given.severities]
        means = {key: tuple(np.mean([row[key] for row in rows], axis=0)) for key in rows[0]}
        print_line(f"{kind} mean", means)


if __name__ == "__main__":
    main()
