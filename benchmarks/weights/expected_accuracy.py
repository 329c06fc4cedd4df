# SPDX-License-Identifier: MIT
"""Line from the mean confidence of a run to its accuracy, written into the card of weights.

There is a line for each width of the weights. It is fitted to sequences of simulated scans that
the weights never saw, and judged on data sets of real ones. `predict` then says how many labels it
expects to be right.

Run: python -m benchmarks.weights.expected_accuracy folder/ WEIGHTS WEIGHTS_OUT --fit DATASET…
     --judge NAME=DATASET[,CLASSES.yaml,LABELS.yaml]…
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.commands import salsanext
from salsanext_cli.core.network.card import AccuracyLine
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.scans.scan_search import find_scans

HALF_WIDTH = 2.0
"""Half the interval of an estimate, in root mean squares of the misses on the judged sequences."""


def measured(dataset: str, out: Path, weights: Path, width: int) -> dict[str, tuple[float, float]]:
    """Return mean confidence and accuracy of each sequence of a labelled data set."""
    path, *spaces = dataset.split(",")
    merged = ["--classes", spaces[0]] if spaces else []
    labels = ["--label-space", spaces[1]] if spaces else []
    network = ("--weights", weights, "--width", width)
    salsanext("predict", path, out, *network, "--probabilities", *merged)
    found = {}
    for sequence in sorted({file.sequence for file in find_scans(Path(path))}):
        files = [file for file in find_scans(Path(path)) if file.sequence == sequence]
        if any(present(file.label_path) for file in files):
            eval_of = salsanext("eval", out, *labels, "--sequences", sequence)
            places = (
                output_path(out, sequence, "uncertainty/least_confidence", file.stem)
                for file in files
            )
            confidence = np.mean([1 - np.nanmean(np.load(place)) for place in places])
            found[sequence] = float(confidence), eval_of["scores"]["accuracy"]
    return found


def logit(share: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the logits of shares, 0 to 1."""
    values = np.asarray(share, np.float64)
    return np.log(values / (1 - values))


def line_at(
    weights: Path, width: int, folder: Path, fit: list[str], judge: list[str]
) -> AccuracyLine:
    """Return the line of images of a width, and print how it is judged."""
    pairs = [
        pair
        for number, dataset in enumerate(fit)
        for pair in measured(dataset, folder / f"fit{number}-{width}", weights, width).values()
    ]
    logits_of_confidence, logits_of_accuracy = logit(np.array(pairs)).T
    slope, offset = np.polyfit(logits_of_confidence, logits_of_accuracy, 1)
    print(f"\n{width} columns\n")
    print("| set | mean confidence % | expected % | right % |\n|---|---|---|---|")
    misses = []
    for each in judge:
        name, dataset = each.split("=", 1)
        out = folder / f"{name}-{width}"
        for sequence, pair in measured(dataset, out, weights, width).items():
            confidence, accuracy = pair
            expected = 1 / (1 + np.exp(-slope * float(logit(confidence)) - offset))
            misses.append(expected - accuracy)
            shares = " | ".join(f"{100 * share:.1f}" for share in (confidence, expected, accuracy))
            print(f"| {name} {sequence} | {shares} |")
    deviation = float(np.sqrt(np.mean(np.square(misses))))
    near = sum(abs(miss) <= 0.05 for miss in misses)
    inside = sum(abs(miss) <= HALF_WIDTH * deviation for miss in misses)
    drives = f"{near} of {len(misses)} within 5 percentage points"
    print(f"\n{drives}, {inside} inside the interval of a run;")
    print(f"root mean square {100 * deviation:.1f}", flush=True)
    return AccuracyLine(
        slope=round(float(slope), 4),
        offset=round(float(offset), 4),
        deviation=round(deviation, 4),
        half_width=round(HALF_WIDTH * deviation, 4),
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("weights", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--fit", nargs="+", required=True)
    parser.add_argument("--judge", nargs="+", required=True)
    given = parser.parse_args()
    card = read_card(given.weights)
    for width in card.trained_widths:
        line = line_at(given.weights, width, given.folder, given.fit, given.judge)
        card = replace(card.at_width(width), accuracy=line)
    save_with_card(given.weights, given.target, card)


if __name__ == "__main__":
    main()
