# SPDX-License-Identifier: MIT
"""Rebuild of the default weights: streets and sensors are simulated, PandaSet's scans are real.

PANDASET is a folder ``sequences/002`` with velodyne/ and labels/: every second scan of the
Pandar64 of that sequence, x forward, y left, z up, intensity / 255, and labels in raw ids of
SemanticKITTI (docs/model-card.md has the map). The last ten are never trained on. The training
has two rounds, the second of which begins with the weights of the first. An interrupted rebuild
goes on where it was.

Run: python benchmarks/default_weights.py pandaset/ folder/
"""

import subprocess
import sys
from pathlib import Path

HELD_OUT = 10
"""Scans of PandaSet that the temperature is fitted on and that are scored."""
STREETS = ("--train", "120", "--valid", "5", "--scans", "8", "--spacing", "10", "--jobs", "2")

DESCRIPTION = (
    "--description",
    "Trained on simulated streets and sensors and on one drive of PandaSet: 960 scans each of "
    "`salsanext synth` with an HDL-64 and with random sensors, 28 of PandaSet (Hesai and Scale AI, "
    "CC BY 4.0). See docs/model-card.md; not for use on real roads.",
)


def salsanext(*words: str | Path) -> None:
    """Run a command of salsanext and stop where it fails."""
    print("salsanext", *words, flush=True)
    subprocess.run(["salsanext", *map(str, words)], check=True)


def link_pandaset(source: Path, root: Path) -> None:
    """Make a data set of links to the scans, in two sequences."""
    scans = sorted((source / "sequences/002/velodyne").glob("*.bin"))
    splits = {"train": scans[:-HELD_OUT], "held-out": scans[-HELD_OUT:]}
    for name, members in splits.items():
        for scan in members:
            label = scan.parent.parent / "labels" / f"{scan.stem}.label"
            for file in (scan, label):
                link = root / "sequences" / name / file.parent.name / file.name
                link.parent.mkdir(parents=True, exist_ok=True)
                if not link.is_symlink():
                    link.symlink_to(file.resolve())
    (root / "labels.yaml").write_bytes((Path(__file__).parent / "pandaset.yaml").read_bytes())


def main() -> None:
    pandaset, out = map(Path, sys.argv[1:3])
    streets, sensors, real = (out / name for name in ("streets", "sensors", "pandaset"))
    runs = [out / "run-1", out / "run-2"]
    if not (streets / "labels.yaml").exists():
        salsanext("synth", streets, *STREETS, "--seed", "0", "--overwrite")
    if not (sensors / "labels.yaml").exists():
        salsanext("synth", sensors, *STREETS, "--seed", "1", "--sensor", "random", "--overwrite")
    link_pandaset(pandaset, real)
    how = ("--also", sensors, "--also", real, "--recipe", "street", "--sensor", "hdl64-512")
    salsanext("train", streets, runs[0], *how)
    salsanext("train", streets, runs[1], *how, "--weights", runs[0] / "last.safetensors")
    half, weights = out / "half.safetensors", out / "default.safetensors"
    if not half.exists():
        salsanext("import-weights", runs[1] / "last.safetensors", half, "--half", *DESCRIPTION)
    if not weights.exists():
        salsanext("tune", "temperature", real, weights, "--weights", half)


if __name__ == "__main__":
    main()
