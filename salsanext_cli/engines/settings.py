# SPDX-License-Identifier: MIT
"""Settings of a network: weights, device, precision and sensor."""

import logging
from contextlib import suppress
from dataclasses import KW_ONLY, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from salsanext_cli.errors import NOTICE, UsageError
from salsanext_cli.option_fields import network_option, option_group

if TYPE_CHECKING:
    from salsanext_cli.classes.label_space import LabelSpace
    from salsanext_cli.engines.network import Network
    from salsanext_cli.sensors.sensor import Sensor

AUTO = "auto"
DEFAULT_WEIGHTS = Path("default")  # Of the package; a file of that name needs an absolute path
COLUMNS_HELP = "Columns of files without a header, such as x,y,z,intensity,_; _ skips a column."
COLUMNS_DEFAULT = "those of the sensor"

log = logging.getLogger(__name__)


@option_group
class NetworkSettings:
    """Settings of a network to load; small enough to be sent to another process."""

    weights: Path | None = network_option(
        "Weights file (.safetensors).", show_default="the weights of the package"
    )
    device: str = network_option(
        "Device; auto: a GPU if there is one.",
        default=AUTO,
        metavar="cpu|cuda|cuda:N",
    )
    _: KW_ONLY
    precision: str = network_option(
        "Precision; auto chooses a fast one for the device.",
        default="float32",
        envvar="SALSANEXT_PRECISION",
        typed=Literal["auto", "float32", "bfloat16", "float16"],
    )
    engine: str = network_option(
        "Library that computes; auto uses OpenVINO on a CPU that it supports.",
        default=AUTO,
        envvar="SALSANEXT_ENGINE",
        typed=Literal["auto", "openvino", "torch"],
    )
    # A `Sensor` is taken as it is, whatever `columns`, `min_range` and `ego` say
    sensor: "Sensor | str | None" = network_option(
        "Sensor of the scans; auto estimates field of view and mounting. A named sensor sets only "
        "intensity scale and noise.",
        default=AUTO,
        typed=str,
        metavar="auto|NAME|FILE",
    )
    columns: str | None = network_option(
        COLUMNS_HELP, metavar="NAMES", show_default=COLUMNS_DEFAULT
    )
    min_range: float | None = network_option(
        "Leave points nearer than this unlabelled, in metres.",
        show_default="1, or 0.8 of the height of a lower sensor",
    )
    ego: str = network_option(
        "Bounding box of your own vehicle, whose points stay unlabelled: x,y,z min, then max, in "
        "metres; auto estimates it from the scans of a drive.",
        default=AUTO,
        metavar="auto|none|BOX",
    )
    intensity: str = network_option(
        "Match the intensity to that of the training scans, use it raw, or ignore it; auto "
        "matches it if the weights describe that of their training scans.",
        default=AUTO,
        typed=Literal["auto", "match", "raw", "none"],
    )
    # Whether a view and a mounting that differ much from the sensor's are those of the scans;
    # None: unless a sensor with a view of its own is named
    fit: bool | None = None
    sha256: str | None = None  # Of the weights file that a run began with; others are refused
    classes: "LabelSpace | None" = None  # As `load_network` takes them

    @property
    def path(self) -> Path:
        """The weights file that was asked for."""
        return weights_file(self.weights)

    @property
    def fits_view(self) -> bool:
        """True if the view is to be fitted to the scans."""
        from salsanext_cli.sensors.sensor import presets

        own_view = self.sensor not in (None, AUTO, *presets())
        return not own_view if self.fit is None else self.fit

    def trained_sensor(self) -> "Sensor":
        """Return the sensor that the weights were trained with."""
        from salsanext_cli.network.card import read_card

        return read_card(self.path).sensor

    def named_sensor(self) -> "Sensor | None":
        """Return the sensor that was asked for, None if none was."""
        # A built-in sensor tells noise and scale of intensity only.
        from salsanext_cli.sensors.sensor import OF_DEVICE, presets, sensor

        named = self.sensor or AUTO
        if not isinstance(named, str):
            return named
        if (named, self.columns, self.min_range, self.ego) == (AUTO, None, None, AUTO):
            return None
        own = trained = self.trained_sensor()
        if named != AUTO:
            own = sensor(named, trained)
        if named in presets():
            own = replace(trained, **{key: getattr(own, key) for key in OF_DEVICE})
        own = with_columns(own, self.columns)
        if self.min_range is not None:
            own = replace(own, min_range=self.min_range)
        if self.ego != AUTO:
            own = replace(own, ego_box=_ego_box(self.ego))
        # Those of training are not those of the scans.
        return replace(own, intensity_quantiles=(), row_gaps=None)

    def load(self) -> "Network":
        """Load the network."""
        from salsanext_cli.engines.loading import load_network, replaced
        from salsanext_cli.files.identity import fingerprint

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

    def announce(self, network: "Network") -> None:
        """Log what computes, and on what the default weights were trained."""
        default = self.weights in (None, DEFAULT_WEIGHTS)
        name = network.card.title(self.path) if default else self.weights
        merged = f", merged into the classes of {network.space.name}" if network.merging else ""
        computing = (
            f"on {network.device} by {network.backend.library} in {network.backend.precision}"
        )
        log.log(NOTICE, "%s %s%s", name, computing, merged)
        if inherited := network.card.inherited():
            hint = ": `salsanext tune error`" if inherited.startswith("error") else ""
            log.log(NOTICE, "%s; not fitted to these weights%s", inherited, hint)

    def resolved(self, network: "Network") -> "NetworkSettings":
        """Log what computes, and return the settings for workers: all the same, same weights."""
        # What is "auto" here might be something else on their machines, and a training that goes on
        # may replace its best weights.
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
    """Return a weights file, that of the package for none or for the name `DEFAULT_WEIGHTS`."""
    from salsanext_cli.network.card import default_weights

    return default_weights() if path in (None, DEFAULT_WEIGHTS) else path


def with_columns(sensor: "Sensor", columns: str | None) -> "Sensor":
    """Return a sensor whose files have other columns, if some were named."""
    if columns is None:
        return sensor
    from salsanext_cli.sensors.sensor import COLUMNS_EXPECTED, are_columns

    names = tuple(name.strip().lower() for name in columns.split(","))
    if not are_columns(names):
        raise UsageError("--columns", columns, COLUMNS_EXPECTED)
    return replace(sensor, columns=names)


def _ego_box(text: str) -> tuple[float, ...]:
    """Return the box that a text tells, nothing for ``none``."""
    from salsanext_cli.sensors.sensor import BOX_EXPECTED, is_box

    box: tuple[float, ...] = ()
    if text != "none":
        with suppress(ValueError):
            box = tuple(float(number) for number in text.split(","))
        if not box or not is_box(box):
            raise UsageError("--ego", text, f"auto, or {BOX_EXPECTED}")
    return box
