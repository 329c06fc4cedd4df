# SPDX-License-Identifier: MIT
"""Compare both kinds of uncertainty of a scan with slow references, and plot the comparison.

Aleatoric: eight noisy copies and assumed density filtering, compared with many noisy copies.
Epistemic: few passes of Monte-Carlo dropout, compared with many.

Run: python examples/uncertainty_figures.py 000000.bin figures/ [256 200 weights.safetensors]
"""

import sys
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

import salsanext_cli as sn
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.records import Float, RangeImage
from salsanext_cli.core.uncertainty.aleatoric import COPIES, aleatoric, noise_variance, noisy_copies
from salsanext_cli.core.uncertainty.monte_carlo import sample

Values = npt.NDArray[np.floating]
PASSES = (2, 3, 5, 10, 20, 30, 50, 100)
COPIES_NAME = f"{COPIES} other copies"


def softmax_of(network: Network, image: Float) -> Float:
    """Return the softmax (C, H, W) of an input (1, 5, H, W)."""
    (prediction,) = network.predict([image], softmax=True)
    assert prediction.softmax is not None
    return prediction.softmax


def deviation_of_copies(image: RangeImage, network: Network, count: int) -> Values:
    """Return the standard deviation of pixels over noisy copies: √ of the mean over classes."""
    copies = islice(noisy_copies(image, network.sensor, 0), count)
    inputs = (network.input(copy) for copy in copies)
    passes = (softmax_of(network, image) for image in inputs)
    first = next(passes).astype(np.float64)
    # Differences from the first copy keep the digits of small variances.
    total, squares = np.zeros_like(first), np.zeros_like(first)
    for probabilities in passes:
        total += probabilities - first
        squares += np.square(probabilities - first)
    variance = (squares - total**2 / count) / (count - 1)
    return np.sqrt(variance.mean(axis=0))


@dataclass(frozen=True)
class Comparison:
    """Both kinds of uncertainty of the pixels that hold a point, and slow references."""

    copies: int
    """Noisy copies of the reference."""
    slow: Values
    """Standard deviation over these copies, (P,)."""
    fast: dict[str, Values]
    """Standard deviation by the name of a faster way, (P,)."""
    passes: int
    """Passes of the reference of the epistemic uncertainty."""
    ranks: dict[int, float]
    """Rank correlation with it, by a lower number of passes."""
    errors: dict[int, float]
    """Mean absolute difference from it as a share of its mean, by a lower number of passes."""

    def rank(self, way: str) -> float:
        """Return the rank correlation of a faster way."""
        return rank_correlation(self.slow, self.fast[way])

    def scale(self, way: str) -> float:
        """Return the median ratio of the deviation by a faster way."""
        positive = self.slow > 0
        return float(np.median(self.fast[way][positive] / self.slow[positive]))


def rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Return Spearman's correlation of the ranks of (N,) values."""
    ranks = np.array([values.argsort().argsort() for values in (one, other)])
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def compared(scan: Path, copies: int, passes: int, weights: str | None = None) -> Comparison:
    """Estimate both kinds of uncertainty of a scan by fast ways and by slow ones."""
    network = sn.load_network(weights, device="cpu")
    # Uncertainty is estimated from the softmax at temperature 1.
    card = replace(network.card, temperature=1.0)
    network = replace(network, backend=replace(network.backend, card=card))
    image = sn.project(sn.read_scan(scan), network.sensor)
    seen = image.point_of_pixel >= 0
    variances = {
        COPIES_NAME: noise_variance(network, image, 1),
        "assumed density filtering": aleatoric(network, image),
    }
    many = sample(network, image, samples=passes, seed=1).uncertainty.epistemic[seen]
    ranks = {}
    errors = {}
    for count in PASSES:
        if count < passes:
            few = sample(network, image, samples=count, seed=2).uncertainty.epistemic[seen]
            ranks[count] = rank_correlation(many, few)
            errors[count] = float(np.abs(few - many).sum() / many.sum())
    return Comparison(
        copies=copies,
        slow=deviation_of_copies(image, network, copies)[seen],
        fast={name: np.sqrt(values.mean(axis=0))[seen] for name, values in variances.items()},
        passes=passes,
        ranks=ranks,
        errors=errors,
    )


def scatter(axes: Axes, comparison: Comparison, way: str) -> None:
    """Plot one value per pixel over another, the line of equal values, and a colour bar."""
    slow = comparison.slow
    fast = comparison.fast[way]
    seen = (slow > 0) & (fast > 0)
    cells = axes.hexbin(slow[seen], fast[seen], xscale="log", yscale="log", gridsize=40, bins="log")
    axes.figure.colorbar(cells, ax=axes, location="bottom", label="pixels per cell")
    low = min(axes.get_xlim()[0], axes.get_ylim()[0])
    high = max(axes.get_xlim()[1], axes.get_ylim()[1])
    axes.plot([low, high], [low, high], "k--", linewidth=2)
    axes.set(xlim=(low, high), ylim=(low, high), aspect="equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(numticks=4))
        axis.set_minor_locator(NullLocator())
    axes.set(title=f"σ by {way},\nrank correlation {comparison.rank(way):.2f}")
    axes.set(xlabel=f"σ by {comparison.copies} copies")


def drawn(comparison: Comparison) -> Figure:
    """Draw the comparison, with text that a telephone can show."""
    with matplotlib.rc_context({"font.size": 19, "axes.titlesize": 19}):
        figure = Figure(figsize=(10, 11), layout="constrained")
        axes = figure.subplot_mosaic("ab;cc", height_ratios=[3, 2])
        for name, way in zip("ab", comparison.fast, strict=True):
            scatter(axes[name], comparison, way)
        counts = [*comparison.ranks]
        axes["c"].semilogx(counts, [*comparison.ranks.values()], "o-", linewidth=3, markersize=10)
        axes["c"].set(title=f"epistemic, against {comparison.passes} passes", xlabel="passes")
        axes["c"].set(ylabel="rank correlation", xticks=counts, xticklabels=counts, ylim=(None, 1))
        axes["c"].minorticks_off()
        axes["c"].grid(alpha=0.3)
    return figure


def main(
    scan: str, folder: str, copies: str = "256", passes: str = "200", weights: str | None = None
) -> None:
    comparison = compared(Path(scan), int(copies), int(passes), weights)
    for way in comparison.fast:
        rank = comparison.rank(way)
        print(f"aleatoric, {way}: rank correlation {rank:.3f}, scale {comparison.scale(way):.3f}")
    for count, rank in comparison.ranks.items():
        error = comparison.errors[count]
        print(f"{count:4d} passes: rank correlation {rank:.3f}, error {error:.1%} of the mean")
    Path(folder).mkdir(parents=True, exist_ok=True)
    drawn(comparison).savefig(Path(folder) / "uncertainty.png", dpi=100)


if __name__ == "__main__":
    main(*sys.argv[1:])
