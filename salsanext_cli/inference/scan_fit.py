# SPDX-License-Identifier: MIT
"""Fit of a network to the scans at hand: what their sensor does otherwise than that of training."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from salsanext_cli.errors import SalsanextError, UsageError
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.intensity import intensity_quantiles
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.records import Float
from salsanext_cli.sensors import INTENSITY_LEVELS, Sensor
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import evenly_spaced

MAX_SCANS = 16
"""Scans that a fit reads, evenly spaced among all of a run."""
INTENSITIES = ("auto", "match", "raw", "none")
SHARED = ("module", "torch_module", "_graphs", "batch_sizes")
"""Cached properties of a network that depend on the size of its images only."""
NO_INTENSITY = (0.0,) * INTENSITY_LEVELS


def fitted(
    settings: NetworkSettings,
    network: Network,
    files: Sequence[ScanFile],
    earlier: Sensor | None = None,
    image_of: Callable[[ScanFile], Float] | None = None,
) -> Network:
    """Return the network with the intensity of its sensor as `settings.intensity` says.

    Parameters
    ----------
    settings : NetworkSettings
    network : Network
        What they load.
    files : sequence of ScanFile
        All scans of the run; unreadable ones do not count, since the run itself names them.
    earlier : Sensor, optional
        Of earlier results in the same folder; what was fitted then stays.
    image_of : callable, optional
        Returns the range image of a scan, (5, H, W) float32; otherwise it is read and projected.

    Raises
    ------
    UsageError
        If there is no such way, or the weights do not know the intensity of their training.
    """
    if not (how := _method(settings, network)):
        return _with_quantiles(network, ())
    known = [sensor.intensity_quantiles for sensor in (earlier, settings.sensor) if sensor]
    if how == "none":
        quantiles = NO_INTENSITY
    else:
        images = sampled_images(files, network.sensor, image_of)
        quantiles = next(filter(None, known), ()) or intensity_quantiles(images)
    return _with_quantiles(network, quantiles)


def _with_quantiles(network: Network, quantiles: tuple[float, ...]) -> Network:
    found = replace(network, sensor=replace(network.sensor, intensity_quantiles=quantiles))
    vars(found).update({name: vars(network)[name] for name in SHARED if name in vars(network)})
    return found


def _method(settings: NetworkSettings, network: Network) -> str:
    """Return "match" or "none", or nothing where the intensity stays as it is."""
    how = settings.intensity
    if how not in INTENSITIES:
        raise UsageError("--intensity", how, ", ".join(INTENSITIES))
    if how == "raw" or network.card.sensor.intensity_quantiles:
        return {"raw": "", "auto": "match"}.get(how, how)
    if how == "auto":
        return ""
    found = f"{how}, but these weights do not know the intensity of their training"
    raise UsageError("--intensity", found, "auto or raw")


def sampled_images(
    files: Sequence[ScanFile],
    sensor: Sensor,
    image_of: Callable[[ScanFile], Float] | None = None,
) -> Iterator[Float]:
    """Yield the range images of scans, evenly spaced; parameters as of `fitted`."""

    def projected(file: ScanFile) -> Float:
        return project(read_scan(file.path, sensor), sensor).channels

    for file in evenly_spaced(files, MAX_SCANS):
        with suppress(SalsanextError):
            yield (image_of or projected)(file)
