# SPDX-License-Identifier: MIT
"""Network that labels in an output folder were made with, for uncertainties beside them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.engines.settings import NetworkSettings, recorded_view
from salsanext_cli.errors import OutputError, UsageError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.geometry.network_input import NO_INTENSITY
from salsanext_cli.network.card import read_card
from salsanext_cli.results.stage_records import StageRecords, as_json
from salsanext_cli.sensors.sensor import FITTED_NAME, Sensor, presets


def require_network_of_labels(out: Path, settings: dict[str, Any]) -> None:
    """Refuse to put the uncertainty of one network beside the labels of another.

    `out`: the output folder; `settings`: of the run of `uncertainty`.
    """
    records = StageRecords(out)
    stage = records.owner("predictions")
    recorded = records.settings(stage) if stage not in (None, "uncertainty") else None
    if recorded is None:
        return
    compared: dict[str, tuple[str, Callable[..., object]]] = {"sensor": ("sensor", _view)}
    if weights := records.weights("predictions"):
        recorded["weights"] = weights
        compared = {"weights": ("weights, and --adapt for both or neither", str)} | compared
        # Those of other programs may be in any classes.
        compared |= {"label_space": ("--classes", _classes)}
    own = settings | {"weights": settings.get("adapted", settings["weights"])}
    for key, (same, seen) in compared.items():
        if key in recorded and seen(recorded[key]) != seen(as_json(own[key])):
            raise OutputError(
                out / f"{stage}.json",
                f"labels made with other {key}",
                "the same for labels and uncertainty",
                f"give the same {same}, or use another output folder",
            )


def _view(sensor: dict[str, Any]) -> dict[str, Any]:
    """Leave out what labels do not depend on."""
    return {**recorded_view(Sensor.from_dict(sensor)), "name": None}


def _classes(space: dict[str, Any]) -> tuple[Any, ...]:
    """Return names and raw ids of the classes."""
    found = LabelSpace.from_dict(space)
    return found.names, found.learning_map_inv


def network_of_labels(out: Path, network: NetworkSettings) -> NetworkSettings:
    """Return the network, looking through the sensor that `predict` used; refuse other weights.

    Its classes are those of the labels, else of uncertainties that are there.
    """
    records = StageRecords(out)
    settings, weights = records.settings("predict"), fingerprint(network.path)
    if earlier := records.settings_with(weights):
        space = LabelSpace.from_dict(earlier.table("label_space"), earlier.path)
        merging = ClassMerging.needed(read_card(network.path).space, space)
        network = replace(network, classes=space if merging else None)
    if settings is None:
        return network
    if settings["weights"] != weights:
        raise UsageError(
            out,
            f"labels by the weights {str(settings['weights'])[:12]}… and no uncertainty yet",
            "the same weights",
            f"give them with --weights, or run `salsanext uncertainty SCANS {out}`",
        )
    seen = Sensor.from_dict(settings.table("sensor"), settings.path)
    ways = {(): "raw", NO_INTENSITY: "none"}
    how = ways.get(seen.intensity_quantiles, network.intensity)
    network = replace(network, adapt="adapted" in settings, intensity=how)
    if network.named_sensor():
        return network
    return replace(network, sensor=_with_noise(seen, network))


def _with_noise(seen: Sensor, network: NetworkSettings) -> Sensor:
    """Return the sensor, of which `predict` recorded only the view, with its noise if known."""
    own = read_card(network.path).sensor
    found = {name: getattr(seen, name) for name in ("columns", "min_range", "ego_box")}
    same = seen.name == FITTED_NAME or replace(own, **found).view() == seen.view()
    noise = presets().get(seen.name) or (own if same else seen)
    return replace(seen, range_noise=noise.range_noise, intensity_noise=noise.intensity_noise)
