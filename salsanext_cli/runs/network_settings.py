# SPDX-License-Identifier: MIT
"""Settings of a network: weights, device, precision and sensor."""

import logging
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.core.errors import NOTICE, UsageError, quoted
from salsanext_cli.core.network.weights_names import DEFAULT_NAME

if TYPE_CHECKING:
    from salsanext_cli.core.classes.label_space import LabelSpace
    from salsanext_cli.core.engines.network import Network
    from salsanext_cli.core.sensors.sensor import Sensor
    from salsanext_cli.io.stated_fields import StatedFields

AUTO = "auto"
MIN_WIDTH = 16  # Columns; a fourth downsampling of the network leaves one
DEFAULT_WEIGHTS = Path(DEFAULT_NAME)

log = logging.getLogger(__name__)


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
    intensity: str = AUTO
    # Whether to fit field of view and mounting to the scans; None: what `sensor` does not state
    fit: bool | None = None
    sha256: str | None = None  # Of the weights file when the run began; other files are refused
    classes: "LabelSpace | None" = None  # As `load_network` takes them

    @property
    def path(self) -> Path:
        """The weights file."""
        return weights_file(self.weights)

    @property
    def named_path(self) -> Path | None:
        """The weights file that the user named; None for the default weights."""
        return self.path if self.weights else None

    @property
    def fits_view(self) -> bool:
        """Whether to fit the field of view to the scans."""
        return not self._stated.view if self.fit is None else self.fit

    @property
    def fits_mounting(self) -> bool:
        """Whether to fit the direction up and the position of the sensor to the scans."""
        return self.fits_view and (self.fit is not None or not self._stated.mounting)

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
        """Return the requested sensor, if any; of a built-in one noise and intensity scale only."""
        from salsanext_cli.core.sensors.sensor import OF_DEVICE, presets
        from salsanext_cli.io.sensors import sensor

        named = self.sensor or AUTO
        if not isinstance(named, str):
            return named
        changes = (self.columns, self.intensity_field, self.width, self.min_range)
        if (named, self.ego) == (AUTO, AUTO) and changes == (None, None, None, None):
            return None
        chosen = trained = self.trained_sensor()
        if named != AUTO:
            chosen = sensor(named, trained)
        if named in presets():
            chosen = replace(trained, **{key: getattr(chosen, key) for key in OF_DEVICE})
        chosen = with_names(chosen, self.columns, self.intensity_field)
        if self.width is not None:
            chosen = with_width(chosen, self.width)
        if self.min_range is not None:
            chosen = replace(chosen, min_range=self.min_range)
        if self.ego != AUTO:
            chosen = replace(chosen, ego_box=_ego_box(self.ego))
        # The scans have another intensity and other gaps than the training.
        return replace(chosen, intensity_quantiles=(), row_gaps=None)

    def load(self) -> "Network":
        """Load the network."""
        from salsanext_cli.io.files.reading import fingerprint
        from salsanext_cli.io.weights.loading import load_network, replaced

        if self.sha256 and self.sha256 != fingerprint(self.path):
            raise replaced(self.path)
        default = self.weights in (None, DEFAULT_WEIGHTS)
        return load_network(
            None if default else self.weights,
            self.device,
            self.named_sensor(),
            self.precision,
            self.engine,
            self.classes,
        )

    def for_sampling(self) -> "NetworkSettings":
        """Return settings of the same network that computes samples in float32 instead of int8."""
        return replace(self, precision="float32") if self.precision == "int8" else self

    def announce(self, network: "Network") -> None:
        """Log weights, device, engine and precision, and parts fitted to other weights."""
        from salsanext_cli.io.weights.card_file import weights_title

        default = self.weights in (None, DEFAULT_WEIGHTS)
        name = weights_title(network.card, self.path) if default else self.weights
        merged = f", merged into the classes of {network.space.name}" if network.merging else ""
        backend = network.backend
        computing = f"on {backend.device} by {backend.library} in {backend.precision}"
        log.log(NOTICE, "%s %s%s", name, computing, merged)
        if inherited := network.card.inherited():
            hint = ": run `salsanext tune error`" if inherited.startswith("error") else ""
            log.log(NOTICE, "%s; not fitted to these weights%s", inherited, hint)
        if others := network.card.of_other_width():
            width = network.sensor.width
            log.log(NOTICE, "%s; not fitted to images of %d columns", others, width)

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
        )


def weights_file(path: Path | None) -> Path:
    """Return a weights file; None and `DEFAULT_WEIGHTS` stand for the weights of the package."""
    from salsanext_cli.io.weights.card_file import default_weights

    return default_weights() if path in (None, DEFAULT_WEIGHTS) else path


def with_names(
    sensor: "Sensor", columns: str | None, intensity_field: str | None = None
) -> "Sensor":
    """Return a sensor with other columns of its files, or another intensity, if they are named."""
    from salsanext_cli.core.sensors.sensor import (
        COLUMNS_EXPECTED,
        FIELD_EXPECTED,
        are_columns,
        is_field,
    )

    if intensity_field is not None:
        if not intensity_field or not is_field(intensity_field):
            raise UsageError("--intensity-field", quoted(intensity_field), FIELD_EXPECTED)
        sensor = replace(sensor, intensity_field=intensity_field)
    if columns is None:
        return sensor
    names = tuple(name.strip().lower() for name in columns.split(","))
    if not are_columns(names):
        raise UsageError("--columns", columns, COLUMNS_EXPECTED)
    return replace(sensor, columns=names)


def with_width(sensor: "Sensor", width: int) -> "Sensor":
    """Return a sensor whose images have another number of columns."""
    from salsanext_cli.core.sensors.sensor import MAX_PIXELS

    most = MAX_PIXELS // sensor.height
    if not MIN_WIDTH <= width <= most:
        raise UsageError("--width", str(width), f"{MIN_WIDTH} to {most} columns")
    return sensor.resized(width=width)


def _ego_box(text: str) -> tuple[float, ...]:
    """Return the numbers of a box, () for ``none``."""
    from salsanext_cli.core.sensors.sensor import BOX_EXPECTED, is_box

    box: tuple[float, ...] = ()
    if text != "none":
        with suppress(ValueError):
            box = tuple(float(number) for number in text.split(","))
        if not box or not is_box(box):
            raise UsageError("--ego", text, f"auto, or {BOX_EXPECTED}")
    return box
