# SPDX-License-Identifier: MIT
"""Train every network of the paper's ablation (Table II) alike, and print their scores.

All networks see the same samples in the same order for the same number of steps. The weights of the
last step are scored, so that nothing is chosen on the scans that score. A finished training is not
repeated; an interrupted one is resumed.

Install the networks first: pip install 'salsanext[paper]', or in a clone: pip install
examples/paper_networks

Run: python examples/ablation.py scenes/ ladder/ [steps [recipe [network ...]]]
"""

import sys
from collections.abc import Iterable
from pathlib import Path

import torch
from paper_networks.figures import costs, paper_figures

import salsanext_cli as sn
from salsanext_cli.commands.stages.evaluate import evaluate
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.train import train
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.network.registry import build
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.training.recipe import recipe

LADDER = {
    "SalsaNet": ("salsanet", False),
    "+ context module": ("salsanet-context", False),
    "+ central dropout": ("salsanet-dropout", False),
    "+ average pooling": ("salsanet-pooling", False),
    "+ dilated convolution": ("salsanet-dilated", False),
    "+ pixel shuffle": ("salsanet-shuffle", False),
    "+ Lovász-Softmax": ("salsanext", True),
}
"""Network of each row, and whether the loss has the Lovász term."""
SENSOR = "hdl64-512"
"""Sensor of all trainings."""
BATCH = 2
"""Samples per step, few because in a short training the number of steps counts."""
VOTES = {"w/o kNN": KnnParameters(k=1, window=1), "with kNN": KnnParameters()}
"""Parameters of kNN; in a window of one pixel only the pixel of the point votes."""


def learn(dataset: Path, run: Path, rung: str, steps: int, plan: str) -> Path:
    """Train a network, and return the weights of the last step."""
    architecture, lovasz = LADDER[rung]
    equal = recipe(plan).with_changes(
        architecture=architecture,
        lovasz=float(lovasz),
        epochs=1,
        batch=BATCH,
        samples_per_epoch=steps * BATCH,
        warm_up=0.1,
        validation_scans=1,
    )
    return train(dataset, run, recipe=equal, sensor=sn.sensor(SENSOR)).last


def mean_iou(dataset: Path, out: Path, weights: Path, knn: KnnParameters) -> float:
    """Score weights on the points of the validation split, in %."""
    selection, options = ScanSelection(split="valid"), RunOptions()
    predict_scans(
        dataset,
        out,
        settings=NetworkSettings(weights, fit=False, intensity="raw"),
        knn=knn,
        selection=selection,
        options=options,
    )
    evaluation = evaluate(out, query=ResultQuery(selection=selection))
    return 100 * evaluation.scores.iou_mean_present


def row(rung: str, scores: Iterable[float]) -> str:
    """Return a row of the table, with the paper's figures in brackets."""
    architecture, lovasz = LADDER[rung]
    with torch.device("meta"):
        counted, operations = costs(build({"name": architecture}))
    paper = paper_figures()["salsanext" if lovasz else architecture]
    printed = zip(scores, (paper.miou_pixels, paper.miou), strict=True)
    ious = [f"{score:.1f} ({figure})" for score, figure in printed]
    figures = (
        f"{counted / 1e6:.2f} ({paper.parameters})",
        f"{operations / 1e9:.1f} ({paper.flops})",
    )
    return " | ".join(("", rung, *ious, *figures, "")).strip()


def main(dataset: str, folder: str, steps: str = "600", plan: str = "street", *rungs: str) -> None:
    if unknown := [rung for rung in rungs if rung not in LADDER]:
        sys.exit(f"unknown: {', '.join(unknown)} (expected {', '.join(LADDER)})")
    titles = (*VOTES, "parameters, 10⁶", "multiply-accumulates, 10⁹ (FLOPs)")
    print(f"| | {' | '.join(titles)} |\n|---|{len(titles) * '---|'}", flush=True)
    for rung in rungs or LADDER:
        run = Path(folder) / LADDER[rung][0]
        weights = learn(Path(dataset), run, rung, int(steps), plan)
        scores = [
            mean_iou(Path(dataset), run / name.replace("/", ""), weights, knn)
            for name, knn in VOTES.items()
        ]
        print(row(rung, scores), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
