# SPDX-License-Identifier: MIT
"""Network that labels in an output folder were made with, for uncertainties beside them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.settings import recorded_view
from salsanext_cli.errors import OutputError
from salsanext_cli.results.stage_records import StageRecords, as_json
from salsanext_cli.sensors.sensor import Sensor


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
