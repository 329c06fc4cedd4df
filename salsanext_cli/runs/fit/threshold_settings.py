# SPDX-License-Identifier: MIT
"""Settings that labels depend on, which a threshold of risk records and compares."""

from typing import Any

from salsanext_cli.core.engines.device import number_type_of_labels
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.fitting.network_fit import intensity_method
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.plain_data import as_json
from salsanext_cli.runs.network_settings import NetworkSettings


def label_settings(settings: NetworkSettings, network: Network) -> dict[str, object]:
    """Return the settings that labels depend on besides weights and scans, by `KEY_OF`."""
    view = (settings.named_sensor() or network.card.sensor).view() | {"fit": settings.fits_view}
    values = {
        "min_range": view.pop("min_range", None),
        "ego": view.pop("ego_box", None),
        "intensity": intensity_method(settings.intensity, network),
        "precision": number_type_of_labels(network.backend.precision),
        "width": view.pop("width"),
        "sensor": {key: value for key, value in view.items() if key != "columns"},
    }
    return dict(as_json({KEY_OF[name]: value for name, value in values.items()}))


def setting_as_typed(argument: str, value: Any) -> str:
    """Return a value of `label_settings` as it is typed for its argument."""
    if argument == "ego" and not value:
        return "auto" if value is None else "none"
    if argument == "ego":
        return ",".join(f"{number:g}" for number in value)
    if argument == "intensity":
        return str(value or "raw")
    if value is None:
        return "the default"
    return f"{value:g}" if isinstance(value, float) else str(value)
