# SPDX-License-Identifier: MIT
"""Files of a version that later versions read; run this file to write those of today."""

import shutil
from functools import partial
from pathlib import Path
from tempfile import gettempdir

from command_line import called
from scans import SMALL, salsanext_of, write_sequence, write_weights
from typer.testing import Result

from salsanext_cli.version import __version__

DATA = Path(__file__).parents[1] / "data" / "compat"
FEW = {"context_width": 4, "widths": (4, 4, 4, 4, 4), "decoder_widths": (4, 4, 4, 4)}
WEIGHTS, SCANS, OUT = "weights.safetensors", "data", "out"
few_channels = partial(salsanext_of, **FEW)  # So that weights are small


def predict(folder: Path, out: Path) -> Result:
    """Predict the scan with the weights, by torch, which computes few channels sooner."""
    network = ("--weights", folder / WEIGHTS, "--sensor", folder / "sensor.toml")
    return called("predict", folder / SCANS, out, *network, "--engine", "torch", "--probabilities")


def write_files(folder: Path) -> None:
    """Write weights, a sensor, a labelled scan, and an output folder with its records."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    data, out = folder / SCANS, folder / OUT
    (folder / "sensor.toml").write_text(SMALL.to_toml(), "utf-8")
    write_sequence(data / "sequences" / "08", count=300)
    with few_channels():
        write_weights(folder / WEIGHTS)
        predict(folder, out)
        called("eval", out, "--dataset", data)
        called("export-ply", out, "--dataset", data)


if __name__ == "__main__":
    made, target = Path(gettempdir(), "compatible"), DATA / __version__  # Records name the folder.
    write_files(made)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(made, target, ignore=shutil.ignore_patterns("*.png"))
    (names,) = target.glob("out/.salsanext.files/*.tsv")
    names.rename(names.with_name("host.tsv"))
