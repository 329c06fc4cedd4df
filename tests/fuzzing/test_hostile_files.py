# SPDX-License-Identifier: MIT
"""Files that somebody made to do harm: one test for each way that once worked."""

import io
import json
import os
import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from claiming import claim
from limits import bounded
from scans import SMALL, files_below, make_scan, write_sequence
from tiny_network import TinyNetwork

from salsanext_cli.classes import label_space
from salsanext_cli.errors import (
    FormatError,
    OutputError,
    SalsanextError,
    UsageError,
    WeightsError,
)
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_bin, read_labels
from salsanext_cli.formats.npy import read_array
from salsanext_cli.network.published import read_published
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.network.weights import WeightsCard, read_card, read_weights, save_weights
from salsanext_cli.sensors import Sensor, sensor
from salsanext_cli.stages.synth import _claim as claim_synth
from salsanext_cli.storage.json_files import read_json
from salsanext_cli.storage.layout import ScanFile, output_path
from salsanext_cli.storage.point_files import write_bin, write_labels
from salsanext_cli.storage.sources import remembered_scans
from salsanext_cli.training.recipe import recipe

SPACE = "labels: {0: a, 1: b}\nlearning_map: {0: 0, 1: 1}\nlearning_map_inv: {0: 0, 1: 1}\n"


@pytest.fixture(scope="module", autouse=True)
def _imported(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Import what readers import when they are first used; that is no matter of the file."""
    path = tmp_path_factory.mktemp("first") / "p.pt"
    for old in (False, True):
        torch.save({"logits.bias": torch.ones(1)}, path, _use_new_zipfile_serialization=not old)
        read_published(path)


def refused(
    path: Path, content: bytes | str, read: Callable[[Path], object], error: type[SalsanextError]
) -> str:
    """Return what a reader says of a file that it refuses, in bounded time and memory."""
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


@pytest.mark.parametrize(
    "text",
    [
        *(LAUGHS, MERGES, "&a [*a]", "a: &a b\nc: *a"),
        *("[" * 20_000, "{a: " * 20_000, "- " * 20_000, "a: !!python/object/apply:os.system [id]"),
        *(
            "2001-99-99",
            "!!timestamp x",
            "!!int ''",
            "!!bool x",
            "!!float x",
            "9" * 5000,
            "!!int -",
        ),
        *("\0", "a: \ud800".encode("utf-8", "surrogatepass").decode("latin-1"), "a: 1\n" * 100_000),
        SPACE + "split: {train: 3}",
        SPACE.replace("0: a", ".inf: a"),
        SPACE.replace("0: a", f"0x{'f' * 6000}: a"),
        SPACE + "color_map: {0: 'long'}",
        SPACE + f"color_map: {{0: {[*range(50_000)]}}}",
        SPACE + f"split: {{train: {{{'x' * 9000}: 1}}}}",
    ],
)
def test_yaml(tmp_path: Path, text: str) -> None:
    refused(tmp_path / "labels.yaml", text, label_space, UsageError)


def test_yaml_without_references_is_read_as_before(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(SPACE)
    assert label_space(tmp_path / "s.yaml").names == ("a", "b")


TOML = "fov_up = 3.0\nfov_down = -25.0\nheight = 64\nwidth = 2048\n"


@pytest.mark.parametrize(
    "text",
    [
        *("a = " + "[" * 9000, "a" + ".a" * 8000 + " = 1", "a = " + "{a = " * 3000, "\0"),
        *(f"a = {'9' * 5000}", "a = 1979-99-99", "a = 1\n" * 3, "a = 1 # " + "x" * (1 << 18)),
        TOML.replace("64", "0x" + "f" * 6000),
        TOML.replace("3.0", "9" * 400),
        TOML.replace("3.0", "nan"),
        TOML.replace("64", "true"),
        TOML + "name = 3",
        TOML + "intensity_scale = inf",
        TOML + f"out_of_view = {'[' * 50 + ']' * 50}",
        TOML + f"means = [1, 2, 3, 4, {'9' * 400}]",
    ],
)
def test_toml_of_a_sensor(tmp_path: Path, text: str) -> None:
    refused(tmp_path / "s.toml", text, sensor, UsageError)


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 20_000, f"epochs = {'9' * 5000}", f"lovasz = {'9' * 400}", "seed = 1e400"],
)
def test_toml_of_a_recipe(tmp_path: Path, text: str) -> None:
    refused(tmp_path / "r.toml", text, recipe, UsageError)


def test_a_sensor_of_pieces_of_text() -> None:
    with pytest.raises(UsageError):
        Sensor.from_dict({**SMALL.to_dict(), "means": "12345"})


@pytest.mark.parametrize(
    "text",
    [
        *(
            "[" * 100_000,
            '{"a":' * 100_000,
            '{"a": NaN}',
            '{"a": -Infinity}',
            f'{{"a": {"9" * 5000}}}',
        ),
        '{"a": ' + "[" * 500 + "]" * 500 + "}",
    ],
)
def test_json(tmp_path: Path, text: str) -> None:
    assert "damaged" in refused(tmp_path / "predict.json", text, read_json, OutputError)


PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("count", ["1000000000000", "1_000_000_000", "100000000", "-1", "9" * 5000])
def test_ply_that_promises_points(tmp_path: Path, form: str, count: str) -> None:
    text = PLY.format(form, count) + "end_header\n1 2 3\n"
    refused(tmp_path / "a.ply", text, read_scan, FormatError)


@pytest.mark.parametrize(
    "header",
    [
        PLY.format("binary_little_endian", "1") + "element nothing 1000000000000\nend_header\n",
        PLY.format("ascii", "1") + "element nothing 1000000000000\nend_header\n",
        PLY.format("ascii", "1") + "element\x1cface\x1c1000000000000\nproperty int i\nend_header\n",
        PLY.format("ascii", "1").replace("\n", "\r")
        + "comment \nend_header \relement face 1000000000000\rproperty int i\rend_header\r",
        PLY.format("binary_little_endian", "1")
        + "element face 10\nproperty list uint int i\nend_header\n",
        "ply\n" + "comment x\n" * 200_000,
    ],
)
def test_ply_that_promises_other_things(tmp_path: Path, header: str) -> None:
    data = header.encode() + b"1 2 3\n" + b"\xff" * 12
    refused(tmp_path / "a.ply", data, read_scan, FormatError)


PCD = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize(
    "size",
    [
        *("POINTS 1000000000000", "WIDTH 1000000000000\nHEIGHT 1000000000000", "POINTS 300000000"),
        *("WIDTH -1\nHEIGHT -1000000", f"POINTS {'9' * 5000}", "POINTS", "POINTS 1e9"),
    ],
)
def test_pcd_that_promises_points(tmp_path: Path, kind: str, size: str) -> None:
    data = f"{PCD}{size}\nDATA {kind}\n".encode() + struct.pack("<II", 8, 0xFFFFFFF0) + bytes(8)
    refused(tmp_path / "a.pcd", data, read_scan, FormatError)


def test_pcd_of_thousands_of_fields(tmp_path: Path) -> None:
    """Each of which was once measured for each."""
    count = 5000
    rows = [
        "FIELDS x y z " + " ".join(f"{n:x}" for n in range(count)),
        *(f"{key} " + f"{value} " * (count + 3) for key, value in (("SIZE", 1), ("TYPE", "U"))),
        "POINTS 1",
    ]
    data = "\n".join([*rows, "DATA binary\n"]).encode() + bytes(count + 3)
    path = tmp_path / "a.pcd"
    path.write_bytes(data)
    with bounded(len(data)):
        assert len(read_scan(path).points) == 1


def test_pcd_that_unpacks_to_more_than_it_can(tmp_path: Path) -> None:
    data = f"{PCD}POINTS 100000000\nDATA binary_compressed\n".encode()
    data += struct.pack("<II", 100, 1_200_000_000) + bytes(100)
    said = refused(tmp_path / "a.pcd", data, read_scan, FormatError)
    assert "100 bytes of compressed data that cannot unpack to 1200000000" in said


@pytest.mark.parametrize(
    "shape", ["1000000000000", "-5", "9" * 30, "0, 1000000000000", "4294967296, 4294967296"]
)
def test_npy_that_promises_values(tmp_path: Path, shape: str) -> None:
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape},), }}".encode()
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(40)
    refused(
        tmp_path / "a.npy", data, lambda path: read_array(path, "float32", (None,)), FormatError
    )


def metadata(**changes: object) -> bytes:
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
def test_safetensors(tmp_path: Path, data: bytes) -> None:
    refused(tmp_path / "w.safetensors", data, read_weights, WeightsError)


class Evil:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.touch, (self.path,)


def archive(pickled: bytes, *, compression: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as members:
        members.writestr("a/data.pkl", pickled)
        members.writestr("a/version", "3\n")
    return stream.getvalue()


@pytest.mark.parametrize(
    "wrap", [bytes, archive, lambda data: b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19." + data]
)
def test_checkpoints_run_nothing(tmp_path: Path, wrap: Callable[[bytes], bytes]) -> None:
    witness = tmp_path / "witness"
    data = wrap(pickle.dumps({"state_dict": Evil(witness)}, protocol=2))
    refused(tmp_path / "p.pt", data, read_published, WeightsError)
    assert not witness.exists()


@pytest.mark.parametrize(
    "data",
    [
        # A text of four gigabytes, so it says.
        b"\x80\x02X\xff\xff\xff\xff.",
        b"\x80\x04\x8d" + b"\xff" * 7 + b"\x7f.",
        archive(bytes(50 << 20), compression=zipfile.ZIP_DEFLATED),
        archive(b"\x80\x02X\xff\xff\xff\xff."),
    ],
)
def test_checkpoints_that_promise_more_than_they_hold(tmp_path: Path, data: bytes) -> None:
    refused(tmp_path / "p.pt", data, read_published, WeightsError)


def test_half_as_large_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody who writes the file anew makes it short for a moment."""
    write_bin(tmp_path / "a.bin", make_scan(10))
    write_labels(tmp_path / "a.label", np.zeros(10, np.uint32))
    original = np.fromfile
    monkeypatch.setattr(np, "fromfile", lambda *given: original(*given)[:-1])
    for read in (read_bin, read_labels):
        with pytest.raises(FormatError, match="changed while it was read"):
            read(tmp_path / ("a.bin" if read is read_bin else "a.label"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bin")
    (tmp_path / "zero.bin").symlink_to("/dev/zero")
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    for name in ("pipe.bin", "zero.bin"):
        with pytest.raises(FormatError, match="neither a file nor a link to one"):
            read_scan(tmp_path / name)
    with pytest.raises(UsageError, match="not a file"):
        label_space(tmp_path / "zero.yaml")


# Nothing is written, and nothing removed, outside of the output folder.


@pytest.mark.parametrize("name", ["..", ".", "", "../../x", "/etc", "a/b", "a/../b", "x\0y"])
def test_names_that_lead_elsewhere(tmp_path: Path, name: str) -> None:
    for sequence, stem in ((name, "a"), ("08", name)):
        with pytest.raises(OutputError, match="cannot name a file"):
            output_path(tmp_path, sequence, "predictions", stem)


@pytest.mark.parametrize("folder", ["../../victim", "/victim", "victim", ".."])
def test_manifests_that_claim_other_folders(tmp_path: Path, folder: str) -> None:
    victim, out = tmp_path / "victim" / "000000.label", tmp_path / "out"
    victim.parent.mkdir()
    victim.touch()
    claim(out, "predict", {"weights": 1}, ["predictions"], overwrite=False)
    manifest = json.loads((out / "predict.json").read_text())
    (out / "predict.json").write_text(json.dumps(manifest | {"writes": [folder]}))
    with pytest.raises(OutputError, match=r"predict\.json"):
        claim(out, "predict", {"weights": 2}, ["predictions"], overwrite=True)
    assert victim.exists()


@pytest.mark.parametrize("stem", ["../../../victim", "/victim", "..", 3, None, ["a"]])
def test_records_of_scans_that_lead_elsewhere(tmp_path: Path, stem: object) -> None:
    out, data = tmp_path / "out", write_sequence(tmp_path / "08", ["a"], count=5)
    scan = ScanFile("08", "a", data / "velodyne/a.bin")
    claim(out, "predict", {}, ["predictions"], [scan], overwrite=False)
    write_labels(output_path(out, "08", "predictions", "a"), np.zeros(5, np.uint32))
    path = out / "sequences/08/source.json"
    before = files_below(tmp_path)
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"asked_for": {"predict": [stem]}}))
    if isinstance(stem, str):
        assert remembered_scans(out) == [scan]
    else:
        with pytest.raises(OutputError, match=r"source\.json · damaged"):
            remembered_scans(out)
    assert files_below(tmp_path).keys() == before.keys()


@pytest.mark.parametrize("folder", [3, ["/"], "a\0b", {"a": 1}])
def test_records_of_folders_that_are_none(tmp_path: Path, folder: object) -> None:
    write_labels(output_path(tmp_path, "08", "predictions", "a"), np.zeros(5, np.uint32))
    (tmp_path / "sequences/08/source.json").write_text(json.dumps({"scans": folder}))
    with pytest.raises(OutputError, match=r"source\.json · damaged"):
        remembered_scans(tmp_path)


@pytest.mark.parametrize("splits", [{"train": ["../../victim"]}, {"train": [3]}, 5, None])
def test_synthetic_data_sets_that_name_folders_elsewhere(tmp_path: Path, splits: object) -> None:
    victim = tmp_path / "victim/velodyne/000000.bin"
    victim.parent.mkdir(parents=True)
    victim.touch()
    own = tmp_path / "out/sequences/00/velodyne/000000.bin"
    own.parent.mkdir(parents=True)
    own.touch()
    (tmp_path / "out/synth.json").write_text(json.dumps({"settings": {"splits": splits}}))
    claim_synth(tmp_path / "out", True)
    assert victim.exists()
    assert not own.exists()


def test_links_in_an_output_folder(tmp_path: Path) -> None:
    """Those to folders are followed, which is how results get onto another disk.

    A link to a file is replaced or removed, and what it leads to stays as it is.
    """
    out, disk, victim = tmp_path / "out", tmp_path / "disk", tmp_path / "victim.label"
    disk.mkdir()
    victim.write_bytes(b"mine")
    claim(out, "predict", {"weights": 1}, ["predictions"], overwrite=False)
    (out / "sequences/08").mkdir(parents=True)
    (out / "sequences/08/predictions").symlink_to(disk)
    (disk / "notes.txt").touch()
    for stem in "ab":
        (disk / f"{stem}.label").symlink_to(victim)
    write_labels(output_path(out, "08", "predictions", "a"), np.zeros(5, np.uint32))
    assert (disk / "a.label").stat().st_size == 20
    claim(out, "predict", {"weights": 2}, ["predictions"], overwrite=True)
    assert [path.name for path in disk.iterdir()] == ["notes.txt"]
    assert victim.read_bytes() == b"mine"


def test_saved_weights_are_read_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
    card = WeightsCard({"name": "salsanext", "class_count": 20}, label_space(), SMALL)
    save_weights(tmp_path / "w.safetensors", TinyNetwork(20), card)
    read_weights(tmp_path / "w.safetensors")
    assert read_card(tmp_path / "w.safetensors").sensor == SMALL
