# SPDX-License-Identifier: MIT
"""What `predict` decides before the first scan: network, scans, folders."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from salsanext_cli.commands.jobs.label_rejection import LabelRejection, label_rejection
from salsanext_cli.commands.jobs.plans.prepared_run import PreparedNetworkRun
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.records import Origin
from salsanext_cli.core.uncertainty.error_features import error_model
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.runs.fit.sensor_fit import network_of_run, settings_of_network
from salsanext_cli.runs.fit.stated_origin import origin_in_frame
from salsanext_cli.runs.loop.recorded_names import with_recorded_names
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.results.folder_names import ERROR, LEAST_CONFIDENCE
from salsanext_cli.runs.results.recorded_origins import folders_of_origins
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, scans_of, space_of


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedPrediction(PreparedNetworkRun):
    """Prediction before its first scan; the labels are the last of its folders."""

    settings: NetworkSettings  # With the origin in the frame of the scans
    rejection: LabelRejection | None  # Rejection of labels
    recorded: PredictSettings


def prepare_prediction(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings,
    knn: KnnParameters,
    extras: tuple[str, ...],
    reject: float | Literal["risk"] | None,
    batch: int | None = None,
    origin: Origin | None,
    selection: ScanSelection,
    overwrite: bool,
) -> PreparedPrediction:
    """Load and fit the network, and find the scans; arguments as of `predict_scans`."""
    typed = settings.named()
    if batch is not None and batch < 1:
        raise UsageError(argument("batch"), str(batch), "at least 1, or auto")
    if origin is not None:
        typed["origin"] = origin
        reader = settings.named_sensor() or settings.trained_sensor()
        settings = replace(settings, origin=origin_in_frame(origin, scans_of(source), reader))
    network = settings.load()
    listed = with_recorded_names(scans_of(source), out)
    scans = choose(listed, selection, space_of(listed, network.card.space), source)
    origins = OriginsOfRun(out=out, stage="predict", listed=listed, overwrite=overwrite)
    network = network_of_run(
        settings, network, listed, out, overwrite=overwrite, origins_of=origins.sample_origins
    )
    rejection = None if reject is None else label_rejection(reject, settings, network, knn)
    extras = _possible_extras(extras, rejection, network)
    return PreparedPrediction(
        out=out,
        stage="predict",
        listed=listed,
        scans=scans,
        recorded=_recorded_settings(network, knn, extras, rejection),
        folders=_folders(out, network, extras),
        overwrite=overwrite,
        weights=settings.named_path,
        options=typed,
        network=network,
        origins=origins,
        settings=settings,
        rejection=rejection,
    )


def _recorded_settings(
    network: Network, knn: KnnParameters, extras: tuple[str, ...], rejection: LabelRejection | None
) -> PredictSettings:
    """Return the settings to record."""
    settings = replace(
        settings_of_network(network, PredictSettings),
        temperature=network.card.temperature,
        knn=knn,
        accuracy=network.card.accuracy,
        objects="objects" in extras or None,
    )
    return rejection.recorded_in(settings) if rejection else settings


def _possible_extras(
    extras: tuple[str, ...], rejection: LabelRejection | None, network: Network
) -> tuple[str, ...]:
    """Return the further results with those that the rejection needs; refuse impossible ones."""
    if rejection and rejection.kind == "error":
        extras = tuple(dict.fromkeys((*extras, ERROR)))
    if ERROR in extras:
        error_model(network)
    if "objects" in extras:
        network.space.require_movable(setting("extras", ("objects",)))
    return extras


def _folders(out: Path, network: Network, extras: tuple[str, ...]) -> tuple[str, ...]:
    """Return the folders of the results, the labels last."""
    origins = folders_of_origins(out, "predict", network.sensor)
    return (*origins, *extras, LEAST_CONFIDENCE, "predictions")
