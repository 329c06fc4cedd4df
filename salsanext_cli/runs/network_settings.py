# SPDX-License-Identifier: MIT
"""Settings of a network to load: weights, device, precision and sensor."""

from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.core.network.weights_names import DEFAULT_NAME
from salsanext_cli.runs.network_announcement import announce_network
from salsanext_cli.runs.sensor_request import AUTO, requested_sensor

if TYPE_CHECKING:
    from salsanext_cli.core.classes.label_space import LabelSpace
    from salsanext_cli.core.engines.network import Network
    from salsanext_cli.core.records import Origin
    from salsanext_cli.core.sensors.sensor import Sensor
    from salsanext_cli.io.stated_fields import StatedFields

DEFAULT_WEIGHTS = Path(DEFAULT_NAME)


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Settings of a network to load; they can be pickled."""

    weights: Path | None = None
    device: str = AUTO
    _: KW_ONLY
    precision: str = "float32"
    engine: str = AUTO
    # A `Sensor` is used unchanged, whatever names, `width`, `min_range` and `ego` are
    sensor: "Sensor | str | None" = AUTO
    columns: str | None = None
    intensity_field: str | None = None
    width: int | None = None
    min_range: float | None = None
    ego: str = AUTO
    # Position of the sensor in the local frame of the scans, metres; None: as `sensor` states it
    origin: "Origin | None" = None
    intensity: str = AUTO
    # Whether to fit field of view and mounting to the scans; None: what `sensor` does not state
    fit: bool | None = None
    sha256: str | None = None  # Of the weights file when the run began; other files are refused
    # Classes to merge those of the weights into, as of `load_network`, or their name or file
    classes: "LabelSpace | str | None" = None

    @property
    def path(self) -> Path:
        """The weights file."""
        return weights_file(self.weights)

    @property
    def named_path(self) -> Path | None:
        """The weights file that the user named; None for the default weights."""
        return self.path if self.weights else None

    def named(self) -> dict[str, object]:
        """Return the settings that the user named and that can be typed, by argument.

        Paths of files are absolute. Weights and device are not among them.
        """
        from salsanext_cli.core.sensors.sensor import presets
        from salsanext_cli.io.label_spaces import typed_label_space

        values = {
            "precision": self.precision,
            "engine": self.engine,
            "sensor": self.sensor,
            "columns": self.columns,
            "intensity_field": self.intensity_field,
            "width": self.width,
            "min_range": self.min_range,
            "ego": self.ego,
            "intensity": self.intensity,
        }
        named: dict[str, object] = {
            name: value
            for name, value in values.items()
            if isinstance(value, str | int | float) and value != AUTO
        }
        sensor = named.get("sensor")
        if sensor is not None and sensor not in presets():
            named["sensor"] = str(Path(str(sensor)).absolute())
        classes = typed_label_space(self.classes)
        if classes is not None:
            named["classes"] = classes
        return named

    @property
    def fits_view(self) -> bool:
        """Whether to fit the field of view to the scans."""
        return not self._stated.view if self.fit is None else self.fit

    @property
    def fits_mounting(self) -> bool:
        """Whether to fit the direction up and the position of the sensor to the scans."""
        is_stated = self._stated.mounting or self.origin is not None
        return self.fits_view and (self.fit is not None or not is_stated)

    @property
    def _stated(self) -> "StatedFields":
        """What the requested sensor states, so that no fit changes it."""
        from salsanext_cli.io.stated_fields import StatedFields, stated_fields

        named = self.sensor or AUTO
        if isinstance(named, str):
            return stated_fields(named)
        return StatedFields(view=True, mounting=True)

    def trained_sensor(self) -> "Sensor":
        """Return the sensor that the weights were trained with."""
        from salsanext_cli.io.weights.card_file import read_card

        return read_card(self.path).sensor

    def named_sensor(self) -> "Sensor | None":
        """Return the requested sensor, if any, as of `requested_sensor`."""
        name = self.sensor or AUTO
        if not isinstance(name, str):
            return name
        return requested_sensor(
            name,
            self.trained_sensor,
            columns=self.columns,
            intensity_field=self.intensity_field,
            width=self.width,
            min_range=self.min_range,
            ego=self.ego,
            origin=self.origin,
        )

    def label_space(self) -> "LabelSpace | None":
        """Return the label space of `classes`; None for the classes of the weights."""
        from salsanext_cli.io.label_spaces import label_space

        return label_space(self.classes) if isinstance(self.classes, str) else self.classes

    def load(self) -> "Network":
        """Load the network."""
        from salsanext_cli.io.files.reading import fingerprint
        from salsanext_cli.io.weights.loading import load_network, replaced_file_error

        if self.sha256 and self.sha256 != fingerprint(self.path):
            raise replaced_file_error(self.path)
        default = self.weights in (None, DEFAULT_WEIGHTS)
        return load_network(
            None if default else self.weights,
            self.device,
            self.named_sensor(),
            self.precision,
            self.engine,
            self.label_space(),
        )

    def for_sampling(self) -> "NetworkSettings":
        """Return settings of the same network that computes samples in float32 instead of int8."""
        return replace(self, precision="float32") if self.precision == "int8" else self

    def announce(self, network: "Network") -> None:
        """Log weights, device, engine and precision, and parts fitted to other weights."""
        from salsanext_cli.io.weights.card_file import weights_title

        is_default = self.weights in (None, DEFAULT_WEIGHTS)
        title = weights_title(network.card, self.path) if is_default else self.weights
        announce_network(network, title)

    def resolved(self, network: "Network", *, silent: bool = False) -> "NetworkSettings":
        """Return settings with which each worker loads the same network, and announce it.

        `silent`: whether nothing will be computed, so that nothing is announced.
        """
        if not silent:
            self.announce(network)
        return replace(
            self,
            device="cpu" if network.device == "cpu" else self.device,
            sensor=network.sensor,
            precision=network.backend.precision,
            engine=network.backend.library,
            sha256=network.backend.sha256,
            classes=self.label_space(),
        )


def weights_file(path: Path | None) -> Path:
    """Return a weights file; None and `DEFAULT_WEIGHTS` stand for the weights of the package."""
    from salsanext_cli.io.weights.card_file import default_weights

    return default_weights() if path in (None, DEFAULT_WEIGHTS) else path
