# SPDX-License-Identifier: MIT
"""No command opens a socket, and none loads the telemetry that is installed with OpenVINO."""

import os
from pathlib import Path

import pytest
from command_line import python
from scans import SMALL, write_sequence

import salsanext_cli
from salsanext_cli.io.kernel_cache import kernel_folder

LISTENER = """
import os, socket, sys

LOOK_UPS = ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr")

def note(event, arguments):
    opened = event == "socket.__new__" and arguments[1] != socket.AF_UNIX
    loaded = event == "import" and arguments[0] == "openvino_telemetry"
    if opened or loaded or event in LOOK_UPS:
        with open(os.environ["SEEN"], "a") as file:
            print(sys.argv, event, arguments[:2], file=file)

sys.addaudithook(note)
"""
"""Module that Python imports first in every process of a run; it audits sockets."""
COMMANDS = """
import sys
from salsanext_cli.commands.line.app import main

for line in {lines!r}:
    sys.argv = ["salsanext", *line]
    try:
        main()
    except SystemExit as leaving:
        assert not leaving.code, line
loaded = [name for name in sys.modules if name.startswith("openvino")]
assert "openvino" in loaded and "openvino_telemetry" not in loaded, loaded
"""


def audited(folder: Path, code: str) -> str:
    """Return the notes of a program that ran with a new cache folder."""
    (folder / "sitecustomize.py").write_text(LISTENER)
    (folder / "seen").touch()
    paths = (folder, Path(salsanext_cli.__file__).parents[1])
    environment = {
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "SEEN": str(folder / "seen"),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR") or kernel_folder(),
    }
    ended = python(code, **environment)
    assert ended.returncode == 0, ended.stderr
    return (folder / "seen").read_text()


@pytest.mark.slow
def test_sockets_and_telemetry_are_noted(tmp_path):
    noted = audited(
        tmp_path,
        "import socket, openvino_telemetry\n"
        "socket.socketpair()\n"
        "socket.socket()\n"
        "socket.getaddrinfo('127.0.0.1', 80)\n",
    )
    events = [line.split("] ")[1].split()[0] for line in noted.splitlines()]
    assert events == ["import", "socket.__new__", "socket.getaddrinfo"]


@pytest.mark.slow
def test_no_command_opens_a_socket_or_loads_telemetry(tmp_path, full_weights):
    data, out, steps = tmp_path / "data", tmp_path / "out", tmp_path / "steps"
    write_sequence(data / "sequences/00", ["0", "1"])
    write_sequence(data / "sequences/08", ["0", "1"])
    sensor = tmp_path / "small.toml"
    sensor.write_text(SMALL.to_toml())
    few = ("--epochs", 1, "--set", "samples_per_epoch=2", "--set", "crop_width=64")
    network = ("--weights", full_weights, "--device", "cpu", "--engine", "openvino")
    lines = [
        ("predict", data, out, *network),
        ("predict", data, out, *network, "--jobs", 2, "--overwrite"),
        ("uncertainty", data, out, *network, "--samples", 2),
        ("eval", out),
        ("export-ply", out, "--colour", "uncertainty"),
        ("picture", out, "--limit", 1),
        ("project", data, steps, "--sensor", sensor),
        ("predict", steps, steps, *network),
        ("knn-refine", steps),
        ("inspect", data),
        ("models", full_weights),
        ("import-weights", full_weights, tmp_path / "again.safetensors"),
        ("export-onnx", full_weights, tmp_path / "weights.onnx"),
        ("tune", "temperature", data, tmp_path / "t.safetensors", *network),
        # Not synth: open3d imports urllib3, which binds a socket to see whether there is IPv6.
        ("train", data, tmp_path / "run", "--recipe", "quick", "--sensor", sensor, *few),
    ]
    words = [[str(word) for word in line] for line in lines]
    assert audited(tmp_path, COMMANDS.format(lines=words)) == ""
    assert list(tmp_path.glob("cache/salsanext/graphs/*.blob"))
