# SPDX-License-Identifier: MIT
"""Uncertainty of scans whose labels are there already, when it is first asked for."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

from salsanext_cli.errors import UsageError
from salsanext_cli.formats.layout import ScanFile, output_path
from salsanext_cli.formats.reading import present
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.batch import BatchOptions, Failure
from salsanext_cli.stages.networks import NetworkChoice
from salsanext_cli.stages.outputs import stage_settings
from salsanext_cli.stages.settings import Settings
from salsanext_cli.stages.uncertainty import SAMPLES, uncertainty_of

log = logging.getLogger(__name__)


def sample_missing(
    out: Path, scans: list[ScanFile], colour: str, network: NetworkChoice, options: BatchOptions
) -> dict[ScanFile, Failure]:
    """Sample the scans that lack an uncertainty, as the others in the folder were sampled.

    Returns the scans that could not be sampled, and why.

    Raises
    ------
    UsageError
        If the labels in the folder were made with other weights.
    """
    folder = f"uncertainty/{colour}"
    missing = [s for s in scans if not present(output_path(out, s.sequence, folder, s.stem))]
    if not missing:
        return {}
    network = _as_predicted(out, network)
    earlier = stage_settings(out, "uncertainty")
    samples = SAMPLES if earlier is None else earlier.integer("samples")
    log.warning("no uncertainty of %d scans yet: sampling %d passes each", len(missing), samples)
    outcome = uncertainty_of(
        missing,
        out,
        network,
        replace(options, overwrite=False),
        knn=KnnParameters() if earlier is None else _recorded_knn(earlier.table("knn")),
        samples=samples,
        seed=0 if earlier is None else earlier.integer("seed"),
        remembered=True,
    )
    return {failure.scan: failure for failure in outcome.failures}


def _recorded_knn(knn: Settings) -> KnnParameters:
    return KnnParameters(
        k=knn.integer("k"),
        window=knn.integer("window"),
        sigma=knn.number("sigma"),
        cutoff=knn.number("cutoff"),
    )


def _as_predicted(out: Path, network: NetworkChoice) -> NetworkChoice:
    """Return the network, looking through the sensor that `predict` used; refuse other weights."""
    settings = stage_settings(out, "predict")
    if settings is None:
        return network
    if settings["weights"] != network.settings()["weights"]:
        raise UsageError(
            out,
            f"labels by the weights {str(settings['weights'])[:12]}… and no uncertainty yet",
            "the same weights",
            "give them with --weights, or run `salsanext uncertainty`",
        )
    seen = Sensor.from_dict(settings.table("sensor"), settings.path)
    return network if network.sensor else replace(network, sensor=seen)
