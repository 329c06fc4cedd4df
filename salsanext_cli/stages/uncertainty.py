# SPDX-License-Identifier: MIT
"""Scans to labels and uncertainties by Monte-Carlo dropout."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.arrays import write_array
from salsanext_cli.formats.kitti import write_labels
from salsanext_cli.formats.layout import ScanFile, output_path
from salsanext_cli.geometry.knn import KnnParameters, knn_refine
from salsanext_cli.network.sampling import require_sampling, sample, scan_seed
from salsanext_cli.records import Float, Int
from salsanext_cli.stages.batch import BatchOptions, Outcome, run_batch
from salsanext_cli.stages.inputs import Choice, select_scans
from salsanext_cli.stages.networks import NetworkChoice
from salsanext_cli.stages.outputs import (
    as_json,
    claim,
    owner,
    recorded_weights,
    stage_settings,
)
from salsanext_cli.stages.predict import most_probable
from salsanext_cli.stages.project import read_image

KINDS = ("epistemic", "entropy", "mutual_information")
WRITES = tuple(f"uncertainty/{kind}" for kind in KINDS)
SAMPLES = 30
"""Passes per scan; the paper's number."""


@dataclass(frozen=True, slots=True)
class UncertaintyOfScan:
    """Sample one scan and write the uncertainty of its points."""

    out: Path
    network: NetworkChoice
    knn: KnnParameters
    samples: int
    seed: int
    writes: tuple[str, ...]

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the files that are written for a scan."""
        return [self._path(file, folder) for folder in self.writes]

    def _path(self, file: ScanFile, folder: str) -> Path:
        return output_path(self.out, file.sequence, folder, file.stem)

    def __call__(self, file: ScanFile) -> None:
        """Read, project, sample, refine, write."""
        network = self.network.load()
        place, space = str(network.device), network.card.space
        image = read_image(file, network.sensor, place)
        seed = scan_seed(self.seed, file.sequence, file.stem)
        sampled = sample(network, image, samples=self.samples, seed=seed)
        for kind in KINDS:
            of_pixels = getattr(sampled.uncertainty, kind)
            of_points = value_of_points(of_pixels, image.pixel_of_point)
            write_array(self._path(file, f"uncertainty/{kind}"), of_points)
        if "predictions" in self.writes:
            pixel_labels = most_probable(sampled.probabilities)
            labels = knn_refine(image, pixel_labels, space.class_count, self.knn, place)
            write_labels(self._path(file, "predictions"), space.to_raw(labels))


def _require_same_network(out: Path, settings: dict[str, Any]) -> None:
    """Refuse to put the uncertainty of one network beside the labels of another."""
    stage = owner(out, "predictions")
    recorded = stage_settings(out, stage) if stage not in (None, "uncertainty") else None
    if recorded and (weights := recorded_weights(out, "predictions")):
        recorded["weights"] = weights
    for key in ("weights", "sensor"):
        if recorded and recorded.get(key, settings[key]) != as_json(settings[key]):
            raise OutputError(
                out / f"{stage}.json",
                f"labels made with other {key}",
                "the same for labels and uncertainty",
                f"give the same {key}, or use another output folder",
            )


def value_of_points(of_pixels: Float, pixel_of_point: Int) -> Float:
    """Give every point its pixel's value: (H, W) to (N,) float32; NaN without a pixel."""
    of_points: Float = of_pixels.ravel()[pixel_of_point]
    of_points[pixel_of_point < 0] = np.nan
    return of_points


def uncertainty(
    source: Path,
    out: Path,
    *,
    network: NetworkChoice = NetworkChoice(),
    knn: KnnParameters = KnnParameters(),
    samples: int = SAMPLES,
    seed: int = 0,
    choice: Choice = Choice(),
    options: BatchOptions = BatchOptions(),
) -> Outcome[None]:
    """Estimate uncertainty into `OUT/sequences/<seq>/uncertainty/<kind>`.

    The labels of the mean of the passes go to `predictions`, unless another stage keeps its
    labels there already: those stay.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    out : Path
        The output folder.
    network : NetworkChoice
        Weights, device and sensor.
    knn : KnnParameters
        Neighbours of the clean-up of the labels.
    samples : int
        Passes per scan, at least 2.
    seed : int
        A scan's masks depend on this, its sequence and its name only.
    choice, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    scans = select_scans(source, choice, network.load().card.space)
    return uncertainty_of(scans, out, network, options, knn=knn, samples=samples, seed=seed)


def uncertainty_of(
    scans: list[ScanFile],
    out: Path,
    network: NetworkChoice,
    options: BatchOptions,
    *,
    knn: KnnParameters = KnnParameters(),
    samples: int = SAMPLES,
    seed: int = 0,
    remembered: bool = False,
) -> Outcome[None]:
    """Do what `uncertainty` does, to scans already chosen, maybe because `out` remembers them."""
    require_sampling(network.load(), samples)
    settings = network.settings() | {"knn": asdict(knn), "samples": samples, "seed": seed}
    labels_too = owner(out, "predictions") in (None, "uncertainty")
    writes = (*WRITES, "predictions") if labels_too else WRITES
    _require_same_network(out, settings)
    sources = () if remembered else scans
    claim(out, "uncertainty", settings, writes, sources, overwrite=options.overwrite)
    work = UncertaintyOfScan(out, network, knn, samples, seed, writes)
    return run_batch(work, scans, options, work.results_of)
