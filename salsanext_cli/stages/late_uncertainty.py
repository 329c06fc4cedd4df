# SPDX-License-Identifier: MIT
"""Uncertainty of scans whose labels are there already, when it is first asked for."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

from salsanext_cli.errors import UsageError
from salsanext_cli.formats.reading import present
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.parallel.run import Failure, RunOptions
from salsanext_cli.sensors import Sensor, presets
from salsanext_cli.stages.uncertainty import uncertainty_of
from salsanext_cli.storage.layout import ScanFile, find_outputs, output_path
from salsanext_cli.storage.recorded_settings import Settings
from salsanext_cli.storage.stage_records import stage_settings
from salsanext_cli.uncertainty.settings import NOISY_KINDS, Estimator

log = logging.getLogger(__name__)


def estimate_missing(
    out: Path, scans: list[ScanFile], colour: str, network: NetworkSettings, options: RunOptions
) -> tuple[str, dict[ScanFile, Failure]]:
    """Estimate the uncertainty of scans that lack it, as that of the others was estimated.

    Returns the kind that the colour means, the total for "uncertainty" if it can be had, and the
    scans whose uncertainty could not be estimated, and why. Shards take what is there.

    Raises
    ------
    UsageError
        If the labels in the folder were made with other weights, or the uncertainties that are
        there without the kind that is asked for; or if a shard finds none at all.
    """
    earlier = stage_settings(out, "uncertainty")
    kind = _kind_there(out) if colour == "uncertainty" else colour
    if kind and (options.shard.count > 1 or not _without(out, scans, kind)):
        # Shards begin at different times: they would not agree on which scans lack it.
        return kind, {}
    if options.shard.count > 1:
        found = f"no uncertainty in {out} yet"
        remedy = "run `salsanext uncertainty` first, with shards too"
        raise UsageError(f"--shard {options.shard}", found, "that of all scans", remedy)
    network = _as_predicted(out, network)
    estimator = _recorded(earlier) if earlier else _possible(colour, network)
    kind = kind or ("total" if estimator.aleatoric else "epistemic")
    if kind not in estimator.kinds:
        remedy = "run `salsanext uncertainty --overwrite`"
        raise UsageError(out, "uncertainty estimated without aleatoric", kind, remedy)
    missing = _without(out, scans, kind)
    log.warning("no uncertainty of %d scans yet: estimating it", len(missing))
    outcome = uncertainty_of(
        missing,
        out,
        network,
        replace(options, overwrite=False),
        knn=KnnParameters() if earlier is None else _recorded_knn(earlier.table("knn")),
        estimator=estimator,
        remembered=True,
    )
    return kind, {failure.scan: failure for failure in outcome.failures}


def _kind_there(out: Path) -> str | None:
    """Say which kind "uncertainty" means where some is there: the total, else the epistemic."""
    kinds = ("total", "epistemic")
    return next((kind for kind in kinds if find_outputs(out, f"uncertainty/{kind}")), None)


def _without(out: Path, scans: list[ScanFile], kind: str) -> list[ScanFile]:
    folder = f"uncertainty/{kind}"
    return [s for s in scans if not present(output_path(out, s.sequence, folder, s.stem))]


def _recorded(settings: Settings) -> Estimator:
    method = settings["method"]
    passes = ("samples", "seed") if method == "sampling" else ()
    numbers = {key: settings.integer(key) for key in passes}
    return Estimator(method, aleatoric=settings.flag("aleatoric"), **numbers)


def _possible(colour: str, network: NetworkSettings) -> Estimator:
    """Leave out what needs a noise that the sensor does not know, unless it is asked for."""
    seen = network.load().sensor
    aleatoric = colour in NOISY_KINDS or seen.knows_noise
    if not aleatoric:
        log.warning("sensor %s does not know its noise: epistemic uncertainty only", seen.name)
    return Estimator(aleatoric=aleatoric)


def _recorded_knn(knn: Settings) -> KnnParameters:
    return KnnParameters(
        k=knn.integer("k"),
        window=knn.integer("window"),
        sigma=knn.number("sigma"),
        cutoff=knn.number("cutoff"),
    )


def _as_predicted(out: Path, network: NetworkSettings) -> NetworkSettings:
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
    return network if network.sensor else replace(network, sensor=_with_noise(seen, network))


def _with_noise(seen: Sensor, network: NetworkSettings) -> Sensor:
    """Return the sensor, of which `predict` recorded only the view, with its noise if known."""
    known = (network.load().sensor, presets().get(seen.name))
    return next((sensor for sensor in known if sensor and sensor.view() == seen.view()), seen)
