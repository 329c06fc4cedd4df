# SPDX-License-Identifier: MIT
"""Hostile files: one case for each attack that once succeeded."""

import json
import struct

import pytest
from limits import bounded
from scans import SMALL

from salsanext_cli import label_space, read_scan, sensor
from salsanext_cli.errors import FormatError, OutputError, UsageError, WeightsError
from salsanext_cli.files.json_files import read_json
from salsanext_cli.formats.npy import read_array
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.weights import read_weights
from salsanext_cli.training.recipe import recipe

SPACE = "labels: {0: a, 1: b}\nlearning_map: {0: 0, 1: 1}\nlearning_map_inv: {0: 0, 1: 1}\n"


def refused(path, content, read, error):
    """Return the error of a reader, raised in bounded time and memory."""
    data = content if isinstance(content, bytes) else content.encode()
    path.write_bytes(data)
    with bounded(len(data)), pytest.raises(error) as caught:
        read(path)
    said = str(caught.value)
    assert len(said) < 2000
    return said


LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{new}: &{new} [*{old}, *{old}]\n" for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)
MERGES = "a: &a {x: 1}\n" + "".join(
    f"{new}: &{new}\n  <<: [{', '.join([f'*{old}'] * 10)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


TOML = "fov_up = 3.0\nfov_down = -25.0\nheight = 64\nwidth = 2048\n"

SETTINGS = {
    "labels.yaml": (
        *(LAUGHS, MERGES, "&a [*a]", "a: &a b\nc: *a"),
        *("[" * 20_000, "{a: " * 20_000, "- " * 20_000, "a: !!python/object/apply:os.system [id]"),
        *("2001-99-99", "!!timestamp x", "!!int ''", "!!bool x", "!!float x", "!!int -"),
        "9" * 5000,
        *("\0", "a: \ud800".encode("utf-8", "surrogatepass").decode("latin-1"), "a: 1\n" * 100_000),
        SPACE + "split: {train: 3}",
        SPACE.replace("0: a", ".inf: a"),
        SPACE.replace("0: a", f"0x{'f' * 6000}: a"),
        SPACE + "color_map: {0: 'long'}",
        SPACE + f"color_map: {{0: {[*range(50_000)]}}}",
        SPACE + f"split: {{train: {{{'x' * 9000}: 1}}}}",
    ),
    "sensor.toml": (
        *("a = " + "[" * 9000, "a" + ".a" * 8000 + " = 1", "a = " + "{a = " * 3000, "\0"),
        *(f"a = {'9' * 5000}", "a = 1979-99-99", "a = 1\n" * 3, "a = 1 # " + "x" * (1 << 18)),
        TOML.replace("64", "0x" + "f" * 6000),
        TOML.replace("3.0", "9" * 400),
        *(TOML.replace("3.0", "nan"), TOML.replace("64", "true"), TOML + "name = 3"),
        TOML + "intensity_scale = inf",
        TOML + f"out_of_view = {'[' * 50 + ']' * 50}",
        TOML + f"means = [1, 2, 3, 4, {'9' * 400}]",
        TOML + 'means = "12345"',
    ),
    "recipe.toml": (
        *("a = " + "[" * 20_000, f"epochs = {'9' * 5000}", f"lovasz = {'9' * 400}", "seed = 1e400"),
    ),
    "predict.json": (
        *("[" * 100_000, '{"a":' * 100_000, '{"a": NaN}', '{"a": -Infinity}'),
        f'{{"a": {"9" * 5000}}}',
    ),
}
READERS = {
    "labels.yaml": (label_space, UsageError),
    "sensor.toml": (sensor, UsageError),
    "recipe.toml": (recipe, UsageError),
    "predict.json": (read_json, OutputError),
}


@pytest.mark.parametrize(
    ("name", "text"), [(name, text) for name, texts in SETTINGS.items() for text in texts]
)
def test_settings_and_records(tmp_path, name, text):
    refused(tmp_path / name, text, *READERS[name])


PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "end_header\n1 2 3\n"
)
PCD = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n{}\nDATA {}\n"
SIZES = (
    *("POINTS 1000000000000", "WIDTH 1000000000000\nHEIGHT 1000000000000", "POINTS 300000000"),
    *("WIDTH -1\nHEIGHT -1000000", f"POINTS {'9' * 5000}", "POINTS", "POINTS 1e9"),
)
COUNTS = ("1000000000000", "-1", "9" * 5000)
PROMISES = [
    *(("a.ply", PLY.format(f, n)) for f in ("ascii", "binary_little_endian") for n in COUNTS),
    *(("a.pcd", PCD.format(n, f)) for f in ("ascii", "binary") for n in SIZES),
    *(("c.pcd", PCD.format(size, "binary_compressed")) for size in SIZES),
]


@pytest.mark.parametrize(("name", "text"), PROMISES)
def test_clouds_that_promise_points(tmp_path, name, text):
    data = text.encode() + struct.pack("<II", 8, 0xFFFFFFF0) + bytes(8)
    refused(tmp_path / name, data, read_scan, FormatError)


NO_HEADERS = (
    *("(" * 9000, "[" * 900 + "]" * 900, "-" * 900 + "1", "{{}: 1}"),
    *("9**9**9", "'\\d'", "1L", "{'shape': 5L}", "{1: 2, 'a': 3}", ""),
)
NPY = "{'descr': '<f4', 'fortran_order': False, 'shape': (%s,), }"


@pytest.mark.parametrize(
    ("header", "shape"),
    [
        *((NPY % shape, (None,)) for shape in ("1000000000000", "-5", "9" * 30, "9" * 5000)),
        *((NPY % f"{n}, {n}", (None, None)) for n in ("4294967296", "-2", "0.5", "[1]")),
        # If one length is 0, the others may be any number.
        (NPY % "5, 0, 999999999999999999", (5, None, None)),
        (NPY % ("0, " * 1000 + "0"), (None,)),
        *((text, (None,)) for text in NO_HEADERS),
        (NPY.replace("'<f4'", "[()]") % "10", (None,)),
        (NPY.replace("'<f4'", "('<f4', (1000000000, 1000000000))") % "10", (None,)),
    ],
)
def test_npy(tmp_path, header, shape):
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + bytes(40)
    refused(tmp_path / "a.npy", data, lambda path: read_array(path, "float32", shape), FormatError)


def metadata(**changes):
    card = WeightsCard({"name": "salsanext", "class_count": 20}, label_space(), SMALL)
    values = json.loads(card.to_metadata()["salsanext"]) | changes
    header = json.dumps({"__metadata__": {"salsanext": json.dumps(values)}}).encode()
    return struct.pack("<Q", len(header)) + header


DEEP = json.dumps({"__metadata__": {"salsanext": '{"a":' * 50_000}}).encode()


@pytest.mark.parametrize(
    "data",
    [
        *(struct.pack("<Q", size) + b"{}" for size in (2**63, 2**64 - 1, 2**40, 3)),
        struct.pack("<Q", len(DEEP)) + DEEP,
        metadata(architecture={"name": "salsanext", "class_count": 10**9}),
        metadata(architecture={"name": "salsanext", "class_count": -1}),
        metadata(architecture={"name": "salsanext", "class_count": 20, "dropout": "x" * 9000}),
        metadata(architecture={"name": "x" * 9000, "class_count": 20}),
        metadata(temperature=int("9" * 4000)),
        metadata(format="x" * 9000),
    ],
)
def test_safetensors(tmp_path, data):
    refused(tmp_path / "w.safetensors", data, read_weights, WeightsError)
