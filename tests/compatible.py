# SPDX-License-Identifier: MIT
"""Files of a version that later versions read; ``python tests/compatible.py`` writes today's."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import gettempdir

import pytest
from scans import SMALL, write_sequence, write_weights
from typer.testing import CliRunner, Result

from salsanext_cli.cli.app import app
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.version import __version__

DATA = Path(__file__).parent / "data" / "compat"
FEW = {"context_width": 4, "widths": (4, 4, 4, 4, 4), "decoder_widths": (4, 4, 4, 4)}
WEIGHTS, SCANS, OUT = "weights.safetensors", "data", "out"


@contextmanager
def few_channels() -> Iterator[None]:
    """Have few channels in the network that is called salsanext, so that weights are small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ARCHITECTURES, "salsanext", partial(SalsaNext, **FEW))
        yield


def run(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def predict(folder: Path, out: Path) -> Result:
    """Predict the scan with the weights, by torch, which computes few channels sooner."""
    network = ("--weights", folder / WEIGHTS, "--sensor", folder / "sensor.toml")
    return run("predict", folder / SCANS, out, *network, "--engine", "torch", "--probabilities")


def write_files(folder: Path) -> None:
    """Write weights, a sensor, a labelled scan, and an output folder with its records."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    data, out = folder / SCANS, folder / OUT
    (folder / "sensor.toml").write_text(SMALL.to_toml(), "utf-8")
    write_sequence(data / "sequences" / "08", count=300)
    with few_channels():
        write_weights(folder / WEIGHTS)
        results = [
            predict(folder, out),
            run("eval", out, "--dataset", data),
            run("export-ply", out, "--dataset", data),
        ]
    for result in results:
        assert result.exit_code == 0, result.output


if __name__ == "__main__":
    made, target = Path(gettempdir(), "compatible"), DATA / __version__  # Records name the folder.
    write_files(made)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(made, target, ignore=shutil.ignore_patterns("*.png"))
    (names,) = target.glob("out/.salsanext.files/*.tsv")
    names.rename(names.with_name("host.tsv"))
