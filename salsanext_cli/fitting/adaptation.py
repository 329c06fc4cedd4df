# SPDX-License-Identifier: MIT
"""Network of a run: fitted and adapted to its scans, as earlier runs in the output folder had it.

An adapted network is a weights file in the output folder, ``OUT/adapted-<digest>.safetensors``: the
weights asked for, with batch-norm statistics moved towards those of the scans. The digest is that
of the weights and of the range images that the statistics were made of, so that shards of a run
agree on it, and no other network ever takes its place.
"""

import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, NoInputError, OutputError, counted
from salsanext_cli.files.atomic import WEIGHTS_SUFFIX
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.locks import locked
from salsanext_cli.files.reading import filled
from salsanext_cli.fitting.label_scan import project_for
from salsanext_cli.fitting.scan_fit import ScanSample, fit_scans
from salsanext_cli.network.card import require_tensors
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import StageRecords
from salsanext_cli.sensors.sensor import Sensor

SHARE = 0.1
"""Share of the statistics of the scans: larger ones lower the accuracy or the mean IoU on one of
three sensors (docs/tune.md)."""
LOCK_TIMEOUT_S = 1800.0
"""Another shard adapts in a minute or two, on a slow processor in some more."""
NAME = f"adapted-{{}}{WEIGHTS_SUFFIX}"

log = logging.getLogger(__name__)


def network_of_run(
    settings: NetworkSettings,
    network: Network,
    files: Sequence[ScanFile],
    out: Path,
    *,
    overwrite: bool = False,
    image_of: Callable[[ScanFile], Float] | None = None,
) -> tuple[NetworkSettings, Network]:
    """Return a network fitted to the scans of a run, and adapted if asked for, and its settings.

    `network`: what they load; `files`: all scans of the source, whichever of them the run is about;
    `out`: its output folder: what earlier results there were made with stays; `overwrite`: whether
    such results will be replaced, and mean nothing; `image_of`: as `ScanSample` takes it.
    """
    earlier = None if overwrite else StageRecords(out).settings_with(network.engine.sha256)
    sensor = Sensor.from_dict(earlier.table("sensor"), earlier.path) if earlier else None
    sample = ScanSample(files, network.sensor, image_of)
    network = fit_scans(settings, network, sample, sensor)
    if not settings.adapt:
        return settings, network
    require_tensors(settings.path)
    if earlier is None:
        made = _adapted_to(network, settings.path, files, sample, out)
    elif "adapted" in earlier:
        made = _as_before(out, earlier["adapted"])
    else:
        remedy = "use another output folder, or --overwrite to replace all its results"
        raise OutputError(earlier.path, "made without --adapt", remedy=remedy)
    settings = replace(settings, adapted=made)
    return settings, settings.load().for_sensor(network.sensor)


def _as_before(out: Path, digest: object) -> Path:
    """Return the adapted weights of this SHA-256 in an output folder."""
    for path in sorted(out.glob(NAME.format("*"))):
        if fingerprint(path) == digest:
            return path
    raise OutputError(
        out,
        "the adapted weights of its results were removed or changed",
        f"{NAME.format('…')} as it was",
        "use another output folder, or --overwrite to replace all its results",
    )


def _adapted_to(
    network: Network, weights: Path, files: Sequence[ScanFile], sample: ScanSample, out: Path
) -> Path:
    """Adapt weights to a sample of the files, unless another shard did; return the file."""
    from salsanext_cli.fitting.batch_norm import require_norms

    require_norms(network)
    images = [channels for channels in sample.images(network.sensor) if channels[0].any()]
    if not images:
        # These raise what is wrong with the first scan, if anything is.
        if sample.image_of:
            sample.image_of(files[0])
        else:
            project_for(network, files[0])
        found = f"no point of {counted(len(files), 'scan')} is in view of the sensor"
        raise NoInputError("--adapt", found, "scans to adapt to")
    digest = hashlib.sha256(f"{network.engine.sha256} {SHARE}".encode())
    for channels in images:
        digest.update(network.fit.input(channels).tobytes())
    path = out / NAME.format(digest.hexdigest()[:12])
    with locked(out / ".adapted.lock", LOCK_TIMEOUT_S):
        OwnedFolder(out).require_own([path])
        if not filled(path):
            log.log(NOTICE, "adapting to %s: %s", counted(len(images), "scan"), path)
            OwnedFolder(out).write(path, _adapted(network, weights, images), durable=True)
    return path


def _adapted(network: Network, weights: Path, images: Sequence[Float]) -> bytes:
    """Return a weights file's content with batch-norm statistics moved towards those of images."""
    from salsanext_cli.fitting.batch_norm import PooledStatistics, as_tensors
    from salsanext_cli.network.weights import with_card

    pooled = PooledStatistics(network, SHARE)
    for channels in images:
        pooled.add(channels)
    done = f"Batch norm re-estimated on {counted(len(images), 'scan')}, share {SHARE:g}."
    return with_card(weights, network.card.changed(done), as_tensors(pooled.moved()))
