# SPDX-License-Identifier: MIT
"""Check both kinds of uncertainty on a scan against the slow way, and draw it.

Aleatoric: assumed density filtering against noisy copies of the scan. Epistemic: fewer passes, and
the analytic estimate, against many passes of Monte-Carlo dropout.

Run: python examples/uncertainty_figures.py 000000.bin figures/ [256 200 weights.safetensors]
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import salsanext_cli as sn
from salsanext_cli.geometry.normalise import noise_of
from salsanext_cli.inference.network import Network
from salsanext_cli.measures.risk_coverage import spearman
from salsanext_cli.records import RangeImage
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.dropout_propagation import propagate_dropout
from salsanext_cli.uncertainty.monte_carlo import sample

Values = npt.NDArray[np.floating]
PASSES = (2, 3, 5, 10, 20, 30, 50, 100)


def noisy_copies(image: RangeImage, network: Network, count: int) -> Iterator[Values]:
    """Yield channels (5, H, W) with errors along the rays and errors of intensity."""
    range_noise, intensity_noise = noise_of(network.sensor)
    random = np.random.default_rng(0)
    occupied = image.channels[0] > 0
    rays = np.zeros_like(image.channels)
    rays[0] = occupied
    np.divide(image.channels[1:4], image.channels[0], out=rays[1:4], where=occupied)
    for _ in range(count):
        along, bright = random.normal(0, 1, (2, *occupied.shape)).astype(np.float32)
        copy = image.channels + rays * range_noise * along
        copy[4] += occupied * intensity_noise * bright
        yield copy


def deviation_of_copies(image: RangeImage, network: Network, count: int) -> Values:
    """Return every pixel's standard deviation over noisy copies, √ of the mean over classes."""
    copies = noisy_copies(image, network, count)
    passes = (network.pixel_probabilities([copy])[0] for copy in copies)
    first = next(passes).astype(np.float64)
    # Differences from the first copy keep the digits of small variances.
    total, squares = np.zeros_like(first), np.zeros_like(first)
    for probabilities in passes:
        total += probabilities - first
        squares += np.square(probabilities - first)
    variance = (squares - total**2 / count) / (count - 1)
    return np.sqrt(variance.mean(axis=0))


def scatter(axes: Axes, slow: Values, fast: Values, titles: tuple[str, str, str]) -> None:
    """Draw one value per pixel against another, and the line where they would be equal."""
    seen = (slow > 0) & (fast > 0)
    axes.hexbin(slow[seen], fast[seen], xscale="log", yscale="log", gridsize=60, bins="log")
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    ends = [min(left, low), max(right, high)]
    axes.plot(ends, ends, "k--", linewidth=1, label="equal")
    axes.set(title=titles[0], xlabel=titles[1], ylabel=titles[2], xlim=ends, ylim=ends)
    axes.legend(loc="upper left")


def main(scan: str, folder: str, copies: str = "256", passes: str = "200", *weights: str) -> None:
    network = sn.load_network(*weights, device="cpu")
    # Uncertainties are those of the plain softmax.
    network = replace(network, card=replace(network.card, temperature=1.0))
    image = sn.project(sn.read_scan(scan), network.sensor)
    seen = image.point_of_pixel >= 0

    slow = deviation_of_copies(image, network, int(copies))[seen]
    fast = np.sqrt(aleatoric(network, image).mean(axis=0))[seen]
    rank, scale = spearman(slow, fast), np.median(fast[slow > 0] / slow[slow > 0])
    print(f"aleatoric, deviation: rank correlation {rank:.3f}, scale {scale:.3f}")

    many = sample(network, image, samples=int(passes), seed=1).uncertainty.epistemic[seen]
    counts = [count for count in PASSES if count < int(passes)]
    ranks = []
    for count in counts:
        few = sample(network, image, samples=count, seed=2).uncertainty.epistemic[seen]
        ranks.append(spearman(many, few))
        error = np.abs(few - many).sum() / many.sum()
        print(f"{count:4d} passes: rank correlation {ranks[-1]:.3f}, error {error:.1%} of the mean")
    once = propagate_dropout(network, image).uncertainty.epistemic[seen]
    one_pass, scale = spearman(many, once), np.median(np.sqrt(once / many))
    print(f"analytic: rank correlation {one_pass:.3f}, scale of the deviation {scale:.3f}")

    figure = Figure(figsize=(15, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    titles = (f"aleatoric, rank correlation {rank:.2f}", f"σ over {copies} noisy copies")
    scatter(left, slow, fast, (*titles, "σ by assumed density filtering"))
    middle.semilogx(counts, ranks, "o-", label="Monte-Carlo dropout")
    middle.axhline(one_pass, color="C1", linestyle="--", label="analytic, one pass")
    middle.set(title=f"epistemic, against {passes} passes", xlabel="passes")
    middle.set(ylabel="rank correlation", xticks=counts, xticklabels=counts, ylim=(None, 1))
    middle.minorticks_off()
    middle.legend()
    titles = (f"epistemic, rank correlation {one_pass:.2f}", f"σ over {passes} passes")
    scatter(right, np.sqrt(many), np.sqrt(once), (*titles, "σ, analytic"))
    Path(folder).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(folder) / "uncertainty.png", dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
