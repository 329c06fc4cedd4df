# SPDX-License-Identifier: MIT
"""Compare both kinds of uncertainty of a scan with slow references, and plot the comparison.

Aleatoric: eight noisy copies and assumed density filtering, compared with many noisy copies.
Epistemic: few passes of Monte-Carlo dropout, compared with many.

Run: python examples/uncertainty_figures.py 000000.bin figures/ [256 200 weights.safetensors]
"""

import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import salsanext_cli as sn
from salsanext_cli.engines.network import Network
from salsanext_cli.records import RangeImage
from salsanext_cli.uncertainty.aleatoric import COPIES, aleatoric, noise_variance, noisy_copies
from salsanext_cli.uncertainty.monte_carlo import sample

Values = npt.NDArray[np.floating]
PASSES = (2, 3, 5, 10, 20, 30, 50, 100)


def deviation_of_copies(image: RangeImage, network: Network, count: int) -> Values:
    """Return the standard deviation of pixels over noisy copies: √ of the mean over classes."""
    copies = islice(noisy_copies(image, network.sensor, 0), count)
    inputs = (network.input(copy) for copy in copies)
    passes = (network.predict([image], softmax=True)[0].softmax for image in inputs)
    first = next(passes).astype(np.float64)
    # Differences from the first copy keep the digits of small variances.
    total, squares = np.zeros_like(first), np.zeros_like(first)
    for probabilities in passes:
        total += probabilities - first
        squares += np.square(probabilities - first)
    variance = (squares - total**2 / count) / (count - 1)
    return np.sqrt(variance.mean(axis=0))


def scatter(axes: Axes, slow: Values, fast: Values, titles: tuple[str, str, str]) -> None:
    """Plot one value per pixel over another, and the line of equal values."""
    seen = (slow > 0) & (fast > 0)
    axes.hexbin(slow[seen], fast[seen], xscale="log", yscale="log", gridsize=60, bins="log")
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    ends = [min(left, low), max(right, high)]
    axes.plot(ends, ends, "k--", linewidth=1, label="equal")
    axes.set(title=titles[0], xlabel=titles[1], ylabel=titles[2], xlim=ends, ylim=ends)
    axes.legend(loc="upper left")


def rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Return Spearman's correlation of the ranks of (N,) values."""
    ranks = [values.argsort().argsort() for values in (one, other)]
    return float(np.corrcoef(ranks)[0, 1])


def main(scan: str, folder: str, copies: str = "256", passes: str = "200", *weights: str) -> None:
    network = sn.load_network(*weights, device="cpu")
    # Uncertainty is estimated from the softmax at temperature 1.
    card = replace(network.card, temperature=1.0)
    network = replace(network, backend=replace(network.backend, card=card))
    image = sn.project(sn.read_scan(scan), network.sensor)
    seen = image.point_of_pixel >= 0

    slow = deviation_of_copies(image, network, int(copies))[seen]
    ways = {
        f"{COPIES} other copies": noise_variance(network, image, 1),
        "assumed density filtering": aleatoric(network, image),
    }
    fast = {name: np.sqrt(values.mean(axis=0))[seen] for name, values in ways.items()}
    for name, values in fast.items():
        rank, scale = rank_correlation(slow, values), np.median(values[slow > 0] / slow[slow > 0])
        print(f"aleatoric, {name}: rank correlation {rank:.3f}, scale of the deviation {scale:.3f}")

    many = sample(network, image, samples=int(passes), seed=1).uncertainty.epistemic[seen]
    counts = [count for count in PASSES if count < int(passes)]
    ranks = []
    for count in counts:
        few = sample(network, image, samples=count, seed=2).uncertainty.epistemic[seen]
        ranks.append(rank_correlation(many, few))
        error = np.abs(few - many).sum() / many.sum()
        print(f"{count:4d} passes: rank correlation {ranks[-1]:.3f}, error {error:.1%} of the mean")

    figure = Figure(figsize=(15, 4.6), layout="constrained")
    *left, right = figure.subplots(1, 3)
    for axes, (name, values) in zip(left, fast.items(), strict=True):
        title = f"aleatoric, rank correlation {rank_correlation(slow, values):.2f}"
        scatter(axes, slow, values, (title, f"σ over {copies} noisy copies", f"σ by {name}"))
    right.semilogx(counts, ranks, "o-")
    right.set(title=f"epistemic, against {passes} passes", xlabel="passes")
    right.set(ylabel="rank correlation", xticks=counts, xticklabels=counts, ylim=(None, 1))
    right.minorticks_off()
    Path(folder).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(folder) / "uncertainty.png", dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
