# SPDX-License-Identifier: MIT
"""Rebuild of the default weights: streets and sensors are simulated, PandaSet's scans are real.

PANDASET holds ``sequences/001`` and ``sequences/002``, each with velodyne/ and labels/: scans of
the Pandar64 of two drives, x forward, y left, z up, intensity / 255, and labels in raw ids of
SemanticKITTI (model-card.md has the map). The last ten of 002 are never trained on. PANDARGT
holds scans of the second sensor of both drives; those from the same time are never trained on
either. AACHEN holds ``sequences/a0`` and ``sequences/a1``, front sectors of a VLP-32C. The same
command continues an interrupted rebuild. What follows --train goes to `salsanext train`. With
--run nothing is trained: a training of `gpu_run.py` is finished.

Run: python -m benchmarks.weights.default_weights pandaset/ folder/ [aachen/] [--pandargt pandargt/]
     [--streets 240] [--seed 0] [--run OUT | --train --weights default --set epochs=6]
"""

import argparse
import json
import math
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.commands import link
from benchmarks.weights.finish_weights import (
    add_error_models,
    add_int8,
    add_temperatures,
    published_card,
    remove_class_weights,
)
from salsanext_cli.core.network.card import scan_digest
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.weights import read_weights, save_weights
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.augment import rotate
from salsanext_cli.training.data.sources import labelled_split

HERE = Path(__file__).parent
LABEL_SPACES = {
    "pandaset": HERE / "pandaset.yaml",
    "pandargt": HERE / "pandaset.yaml",
    "aachen": HERE / "aachen.yaml",
}
"""Label spaces of the data sets with real scans; no others are trained on."""
DRIVES = ("001", "002")
HELD_OUT = 10
"""Last scans of PandaSet, which are validated and which the temperature is fitted on too."""
STREETS_PER_VALIDATED = 4
"""Validation scans of the streets for each that every validation scores: ten of forty."""
SECTORS = 8
"""Sectors of 46° that fill a circle."""
SCANS_OF_STREET = 8
SIMULATED = "scenes simulated"
"""Figure of a training on a GPU: streets, each of as many scans."""
STREETS = ("--valid", "5", "--scans", SCANS_OF_STREET, "--spacing", "10", "--jobs", "2")

DESCRIPTION = (
    "Trained on simulated scenes and sensors and on {drives}: {simulated} scans "
    "of `salsanext synth`, half with an HDL-64 and half with random sensors, {real} of PandaSet "
    "(Hesai and Scale AI, CC BY 4.0).{aachen} See model-card.md; not for use on real roads."
)
AACHEN = (
    " Also {sectors} front sectors of one drive in Aachen (ika, RWTH Aachen, MIT), whose labels "
    "are from a network for camera images."
)


def salsanext(*words: str | int | Path) -> None:
    """Run a command of salsanext and stop where it fails."""
    print("salsanext", *words, flush=True)
    subprocess.run(["salsanext", *map(str, words)], check=True)


def split_pandaset(
    scans: Mapping[str, Sequence[ScanFile]],
) -> tuple[list[ScanFile], dict[str, list[ScanFile]]]:
    """Return the scans of PandaSet's sensors to train on, and the scans held out, by sensor.

    Sensors are ``pandaset``, whose last scans are held out, and perhaps ``pandargt``, whose scans
    from the same time are held out too. The name of each sequence begins with that of its sensor,
    so that every sensor is fitted to its own scans.
    """
    first = scans["pandaset"][-HELD_OUT:][0]
    training: list[ScanFile] = []
    held_out: dict[str, list[ScanFile]] = {name: [] for name in scans}
    for name, files in scans.items():
        for file in files:
            late = (file.sequence, file.stem) >= (first.sequence, first.stem)
            target = held_out[name] if late else training
            target.append(replace(file, sequence=f"{name}-{file.sequence}"))
    return training, held_out


def link_pandaset(roots: Mapping[str, Path], root: Path) -> list[ScanFile]:
    """Make a data set of links to the scans of `split_pandaset`; return those to train on."""
    scans = {name: find_scans(source, DRIVES) for name, source in roots.items()}
    training, held_out = split_pandaset(scans)
    for file in training:
        link(file, root / "sequences" / file.sequence)
    for name, files in held_out.items():
        for file in files:
            link(file, root / "sequences" / f"held-out-{name}")
    splits = {
        "train": sorted({file.sequence for file in training}),
        "valid": [f"held-out-{name}" for name, files in held_out.items() if files],
    }
    space = label_space(LABEL_SPACES["pandaset"]).to_dict()
    (root / "labels.yaml").write_text(json.dumps(space | {"split": splits}))
    return training


def link_streets(streets: Path, real: Path, root: Path) -> None:
    """Make a data set of links to the streets that is validated on real scans, too."""
    space, training = labelled_split(streets, None, "train")
    for file in training:
        link(file, root / "sequences" / file.sequence)
    simulated = labelled_split(streets, None, "valid")[1][::STREETS_PER_VALIDATED]
    validated = [("valid-streets", file) for file in simulated]
    validated += [
        (f"valid-{file.sequence}", file) for file in labelled_split(real, None, "valid")[1]
    ]
    for name, file in validated:
        link(file, root / "sequences" / name)
    names = {"train": space.split("train"), "valid": sorted({name for name, _ in validated})}
    (root / "labels.yaml").write_text(json.dumps(space.to_dict() | {"split": names}))


def sectors_of(aachen: Path) -> list[ScanFile]:
    """Return the sectors to train on, as many as fill whole circles."""
    files = find_scans(aachen, ["a0", "a1"])
    return files[: len(files) // SECTORS * SECTORS]


def compose_circles(aachen: Path, root: Path) -> None:
    """Make a data set of full circles, each of sectors that lie far apart on the drive.

    A window of the image of a single sector would be empty, or for three quarters at least.
    """
    if (root / "labels.yaml").exists():
        return
    sequence = root / "sequences/train"
    for folder in ("velodyne", "labels"):
        (sequence / folder).mkdir(parents=True, exist_ok=True)
    files = sectors_of(aachen)
    circles = len(files) // SECTORS
    for circle in range(circles):
        points, labels = [], []
        for place, file in enumerate(files[circle::circles]):
            sector = np.fromfile(file.path, np.float32).reshape(-1, 4)
            sector[:, :3] = rotate(sector[:, :3], 2 * math.pi * place / SECTORS)
            points.append(sector)
            labels.append(np.fromfile(file.label_path, np.uint32))
        np.concatenate(points).tofile(sequence / f"velodyne/{circle:06}.bin")
        np.concatenate(labels).tofile(sequence / f"labels/{circle:06}.label")
    (root / "labels.yaml").write_bytes(LABEL_SPACES["aachen"].read_bytes())


def finish(
    run: Path,
    datasets: Sequence[Path],
    target: Path,
    description: str,
    sectors: Sequence[ScanFile] = (),
) -> None:
    """Write the last weights of a run in float16, without class weights, with a temperature.

    The weights know the sectors of the circles that they were trained on.
    """
    module, card = read_weights(run / "last.safetensors")
    remove_class_weights(module, card, run / "class_counts.json")
    digests = {scan_digest(read_scan(file.path, card.sensor)) for file in sectors}
    card = replace(published_card(card, description), trained_on=card.trained_on | digests)
    half = target.with_name("half.safetensors")
    save_weights(half, module, card, half=True)
    add_temperatures(half, target, datasets)


def simulated_scans(run: Path) -> int:
    """Return the number of scans that a run of `gpu_run.py` simulated."""
    figures = json.loads((run / "report.json").read_text())["parts"]["train"]["figures"]
    scenes = next(row["value"] for row in figures if row["name"] == SIMULATED)
    return int(scenes) * SCANS_OF_STREET


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("pandaset", "folder"):
        parser.add_argument(name, type=Path)
    parser.add_argument("aachen", type=Path, nargs="?")
    parser.add_argument("--pandargt", type=Path, help="scans of PandaSet's second sensor")
    text = "streets of each data set to train on (%(default)s)"
    parser.add_argument("--streets", type=int, default=240, help=text)
    text = "seed of the streets; the next one is that of the random sensors' (%(default)s)"
    parser.add_argument("--seed", type=int, default=0, help=text)
    parser.add_argument("--run", type=Path, help="results of gpu_run.py to finish")
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=[])
    given = parser.parse_args()
    # The command that runs ends with this script.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    out: Path = given.folder
    streets, sensors, real = (out / name for name in ("streets", "sensors", "pandaset"))
    simulated = ("--train", given.streets, *STREETS)
    salsanext("synth", streets, *simulated, "--seed", given.seed)
    salsanext("synth", sensors, *simulated, "--seed", given.seed + 1, "--sensor", "random")
    roots = {"pandaset": given.pandaset, "pandargt": given.pandargt}
    scans = link_pandaset({name: root for name, root in roots.items() if root}, real)
    link_streets(streets, real, out / "validated")
    also, sectors = [sensors, real], []
    if given.aachen:
        sectors = sectors_of(given.aachen)
        compose_circles(given.aachen, out / "aachen")
        also.append(out / "aachen")
    run: Path = given.run or out / "run"
    if not given.run:
        how = [word for dataset in also for word in ("--also", dataset)]
        how += ["--recipe", "street", "--sensor", "hdl64-512", *given.train]
        salsanext("train", out / "validated", run, *how)
    description = DESCRIPTION.format(
        simulated=simulated_scans(run) if given.run else 2 * given.streets * SCANS_OF_STREET,
        real=len(scans),
        drives="two drives of PandaSet and one in Aachen" if sectors else "two drives of PandaSet",
        aachen=AACHEN.format(sectors=len(sectors)) if sectors else "",
    )
    finish(run, (streets, real), out / "default.safetensors", description, sectors)
    add_error_models(out / "default.safetensors", (streets, sensors))
    add_int8(out / "default.safetensors", (streets, sensors, real))


if __name__ == "__main__":
    main()
