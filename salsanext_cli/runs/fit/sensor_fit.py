# SPDX-License-Identifier: MIT
"""Fit of a network to the scans of a run: its files, its settings, its earlier results.

`core.fitting.network_fit` does the fit.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from salsanext_cli.core.engines.device import number_type_of_labels
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.fitting.network_fit import FitSettings, fit_to_sample
from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.fitting.view_fit import fit_sensor, fit_views
from salsanext_cli.core.records import Origins, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.fit.scan_sample import MAX_SCANS, ImageOf, OriginsOf, sample_of_files
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import ComputedSettings
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import evenly_spaced

Computed = TypeVar("Computed", bound=ComputedSettings)


def fit_network(
    network: Network,
    scans: Path | str | Sequence[Scan],
    *,
    view: bool = True,
    intensity: str = "auto",
) -> Network:
    """Return the network with its sensor fitted to scans, as `predict` does.

    Parameters
    ----------
    network : Network
        Network with the sensor of its weights.
    scans : Path, str or sequence of Scan
        A scan, a folder of scans, a sequence or a data set, or scans in memory. The fit reads up
        to 16 of them, evenly spaced. Scans of files that are registered to a map are seen from the
        positions of a `poses.txt` beside them, if it agrees with their points, as in `predict`;
        those in memory from where their points show the sensor.
    view : bool
        Whether to fit the field of view and the mounting; unknown bounds of housing and vehicle are
        always fitted.
    intensity : {"auto", "match", "raw", "none"}
        Whether to match the intensity to that of training; "auto" does if the weights state it.

    Returns
    -------
    Network
        Network for the sensor of the scans.

    Raises
    ------
    NoInputError
        If there are no scans at the path.
    UsageError
        If `intensity` is another word, or the weights do not state the intensity of training.
    """
    if isinstance(scans, Path | str):
        files = find_scans(Path(scans))
        sample = sample_of_files(files, network.sensor, origins_of=_by_poses_beside(files))
    else:
        sample = ScanSample.from_scans(evenly_spaced(scans, MAX_SCANS))
    return fit_to_sample(network, sample, FitSettings(view=view, intensity=intensity))


def _by_poses_beside(files: Sequence[ScanFile]) -> OriginsOf:
    """Return a function of some scans of a source to their origins by the poses beside them."""

    def origins_of(chosen: Sequence[ScanFile], sensor: Sensor) -> Origins:
        # Only here, because only registered scans need it.
        from salsanext_cli.runs.fit.pose_origins import origins_by_poses

        return origins_by_poses(chosen, sensor, files).origins

    return origins_of


def resolved_for(
    settings: NetworkSettings, network: Network, scans: Sequence[ScanFile]
) -> NetworkSettings:
    """Return settings with which each worker loads the network; announce it if it computes."""
    return settings.resolved(network, silent=is_unreadable(scans, network))


def is_unreadable(scans: Sequence[ScanFile], network: Network) -> bool:
    """Return whether the only scan cannot be read, so that nothing is computed."""
    return len(scans) == 1 and not sample_of_files(scans, network.sensor).read


def fit_scans(
    settings: NetworkSettings, network: Network, sample: ScanSample, earlier: Sensor | None = None
) -> Network:
    """Return a loaded network fitted to scans; the fit for `earlier` results stays."""
    return fit_to_sample(network, sample, fit_settings(settings), earlier)


def fit_settings(settings: NetworkSettings) -> FitSettings:
    """Return what the settings of a network let its fit change."""
    return FitSettings(
        view=settings.fits_view,
        mounting=settings.fits_mounting,
        intensity=settings.intensity,
        named=settings.named_sensor(),
        is_width_named=settings.width is not None,
    )


def fitted_view(
    files: Sequence[ScanFile],
    sensor: Sensor,
    earlier: Sensor | None = None,
    *,
    view: bool = True,
    mounting: bool = True,
) -> Sensor:
    """Return the sensor fitted to a sample of scans by `fit_sensor`."""
    sample = sample_of_files(files, sensor)
    return fit_sensor(sample, sensor, earlier, view=view, mounting=mounting)


def fitted_members(
    files: Sequence[ScanFile],
    sensor: Sensor,
    earlier: Sensor | None = None,
    *,
    view: bool = True,
    mounting: bool = True,
) -> Sensor:
    """Return the sensor fitted to a sample of scans by `fit_views`.

    Sensors of equal views stay apart, because their intensities may differ.
    """
    sample = sample_of_files(files, sensor)
    return fit_views(sample, sensor, earlier, view=view, mounting=mounting)


def network_of_run(
    settings: NetworkSettings,
    network: Network,
    files: Sequence[ScanFile],
    out: Path,
    *,
    overwrite: bool = False,
    image_of: ImageOf | None = None,
    origins_of: OriginsOf | None = None,
) -> Network:
    """Return a network fitted to the scans of a run, or as for earlier results in its folder.

    `image_of`, `origins_of`: range images and origins of the scans, as of `sample_of_files`.
    """
    earlier = None if overwrite else _earlier_sensor(Manifest(out), network)
    sample = sample_of_files(files, network.sensor, image_of, origins_of)
    return fit_scans(settings, network, sample, earlier)


def _earlier_sensor(records: Manifest, network: Network) -> Sensor | None:
    """Return the sensor of earlier results of the same weights, None without any."""
    for recorded in (records.settings("predict"), records.settings("uncertainty")):
        if recorded and recorded.weights == network.backend.sha256:
            return recorded.sensor
    return None


def settings_of_network(network: Network, kind: type[Computed]) -> Computed:
    """Return the settings of a network that the results of a stage depend on.

    Parameters
    ----------
    network : Network
        Network that computes the results, fitted to the scans.
    kind : type
        Class of the settings of the stage, a subclass of `ComputedSettings`. Its other fields have
        their defaults.

    Returns
    -------
    ComputedSettings
        An instance of `kind`.
    """
    backend = network.backend
    card = network.card
    inherited = [text for text in (card.inherited(), card.parts_of_default_width()) if text]
    return kind(
        weights=backend.sha256,
        weights_version=card.version,
        inherited="; ".join(inherited) or None,
        label_space=network.space,
        sensor=network.sensor.without_noise(),
        precision=number_type_of_labels(backend.precision),
        engine=backend.library,
        trained_on="".join(sorted(card.trained_on)) or None,
    )
