# SPDX-License-Identifier: MIT
"""Every reader of the package, and valid files to damage."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bags
import captures
import numpy as np
import pytest
import torch
import yaml
from e57_files import Station, write_e57
from edited_clouds import write_pcd
from fuzzing.cloud_seeds import (
    feather,
    leica,
    lines,
    named_lines,
    npz,
    organised,
    parquet,
    structured,
)
from las_files import size_records, text_record, write_las
from ouster_recordings import write_recording
from scans import SMALL, make_scan
from tiny_network import TinyNetwork

from salsanext_cli import LabelSpace, label_space, project, read_labels, read_scan, sensor
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.io.annotation_tools.registry import TOOLS
from salsanext_cli.io.formats import recordings
from salsanext_cli.io.formats.captures import maker_of
from salsanext_cli.io.formats.npy import read_array
from salsanext_cli.io.formats.ply import write_ply
from salsanext_cli.io.weights.published import read_published
from salsanext_cli.io.weights.weights import read_weights, save_weights
from salsanext_cli.runs.results.output_run import encode_array
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.recipe import Recipe, recipe

FEW = LabelSpace.from_dict(
    {
        "name": "few",
        "labels": {0: "nothing", 10: "car", 40: "road"},
        "color_map": {10: [255, 0, 0]},
        "learning_map": {0: 0, 10: 1, 40: 2},
        "learning_map_inv": {0: 0, 1: 10, 2: 40},
        "split": {"train": [0, 1], "valid": ["08"]},
    }
)
COUNT = 30
"""Points of the scans: a file so small is hit everywhere."""


FOOT = 'LOCAL_CS["site",LOCAL_DATUM["site",0],UNIT["foot",0.3048],AXIS["x",EAST]]'


@dataclass(frozen=True, slots=True)
class Reader:
    """A reader, the name of the file that it is given, and valid files."""

    place: str
    seeds: list[bytes]
    read: Callable[[Path], object]


def _scan(path: Path) -> None:
    """Read a scan and use it as every stage does."""
    scan = read_scan(path)
    project(scan, SMALL)
    check_scan(path, scan, SMALL)


def _table() -> dict[str, np.ndarray]:
    scan = make_scan(COUNT)
    columns = dict(zip("xyz", scan.points.T, strict=True))
    return {**columns, "intensity": scan.intensity, "ring": np.arange(COUNT, dtype=np.uint8)}


def _bin(columns: int) -> list[bytes]:
    table = np.column_stack([*_table().values()])[:, :columns].astype("<f4")
    others = (table.astype("<f8").round(3), table.T, table.astype("<f2"))
    return [table.tobytes(), table[:3].tobytes(), *(other.tobytes() for other in others)]


def _ply(folder: Path) -> list[bytes]:
    import plyfile

    write_ply(folder / "a.ply", _table(), ["by a test"])
    seeds = [(folder / "a.ply").read_bytes()]
    vertices = np.zeros(4, [("x", "f8"), ("y", "f4"), ("z", "f4"), ("i", "u2")])
    faces = np.empty(2, [("vertex_indices", "O")])
    faces["vertex_indices"] = [np.array([0, 1, 2], "i4"), np.array([1, 2, 3], "i4")]
    elements = [plyfile.PlyElement.describe(vertices, "vertex")]
    elements.append(plyfile.PlyElement.describe(faces, "face"))
    for text, order in ((True, "="), (False, "<"), (False, ">")):
        for chosen in (elements, elements[::-1]):
            stream = io.BytesIO()
            plyfile.PlyData(chosen, text=text, byte_order=order).write(stream)
            seeds.append(stream.getvalue())
    return seeds


def _pcd(folder: Path, form: str) -> list[bytes]:
    table = _table()
    points = np.column_stack([table.pop(axis) for axis in "xyz"])
    path = write_pcd(folder / "a.pcd", points, table, form=form.partition("_")[0])
    content = path.read_bytes()
    if form != "binary_compressed":
        return [content]
    header = content.partition(b"binary\n")[0] + b"binary_compressed\n"
    plain = b"".join(values.tobytes() for values in (*points.T, *table.values()))
    # Literal runs only, which is compressed data too.
    pieces = [plain[at : at + 32] for at in range(0, len(plain), 32)]
    packed = b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)
    return [header + np.array([len(packed), len(plain)], "<u4").tobytes() + packed]


def _safetensors(folder: Path) -> list[bytes]:
    card = WeightsCard({"name": "salsanext", "class_count": FEW.class_count}, FEW, SMALL)
    save_weights(folder / "w.safetensors", TinyNetwork(FEW.class_count), card)
    save_weights(folder / "h.safetensors", TinyNetwork(FEW.class_count), card, half=True)
    return [(folder / name).read_bytes() for name in ("w.safetensors", "h.safetensors")]


def _published() -> Reader:
    tensors = {
        "module.logits.weight": torch.ones(3, 2, 1, 1),
        "module.logits.bias": torch.zeros(3),
        "module.upBlock1.bn4.bias": torch.ones(2),
    }
    seeds = []
    for checkpoint in ({"state_dict": tensors, "epoch": 3, "info": {"best": 0.5}}, tensors):
        stream = io.BytesIO()
        torch.save(checkpoint, stream)
        seeds.append(stream.getvalue())
    return Reader("p.pt", seeds, read_published)


def _bag(folder: Path) -> Reader:
    pytest.importorskip("rosbags")
    clouds = bags.messages([bags.structured(COUNT, seed) for seed in range(4)])
    path = bags.write_bag(folder, ".db3", [*clouds, ("/chat", bags.START, bags.text)])
    return Reader("a.db3", [path.read_bytes()], _recorded)


def _pcap(folder: Path) -> Reader:
    """Return packets of an Ouster sensor; OSF files take too long, with a process for each."""
    pytest.importorskip("ouster.sdk")
    path = write_recording(folder / "a.pcap", 1)
    return Reader(str(path), [path.read_bytes()], _recorded)


def _capture(folder: Path) -> bytes:
    """Return packets of a VLP-16."""
    random = np.random.default_rng(0)
    packets = []
    for number in range(6):
        distances = random.uniform(1, 90, (12, 32))
        intensities = random.integers(0, 256, (12, 32))
        packets.append(captures.Sent(captures.vlp16(80.0 * number, distances, intensities)))
    return captures.write_capture(folder / "v.pcap", packets).read_bytes()


def _velodyne(folder: Path) -> Reader:
    pytest.importorskip("velodyne_decoder")
    return Reader("v.pcap", [_capture(folder)], _recorded)


def _las(folder: Path, name: str) -> Reader:
    """Return the seeds of LAS files of an old and of a new point format."""
    pytest.importorskip("lazrs")
    points = make_scan(COUNT).points
    records = {"records": size_records(0.3), "extended_records": [text_record(FOOT)]}
    seeds = [
        write_las(folder / name, points, kind=kind, **others).read_bytes()
        for kind, others in ((3, {}), (6, {}), (6, records))
    ]
    return Reader(name, seeds, _scan)


def _e57(folder: Path) -> Reader:
    pytest.importorskip("pye57")
    path = write_e57(folder / "a.e57", [Station(make_scan(COUNT).points.astype(np.float64))])
    return Reader("a.e57", [path.read_bytes()], _recorded)


def _recorded(path: Path) -> None:
    """Read every scan of a recording, or fail at the first."""
    recordings._recording.cache_clear()
    for scan in find_scans(path):
        read_scan(scan.path)


def _labels_of(tool: str) -> Callable[[Path], object]:
    """Return the reader of labels that a tool saved."""
    return lambda path: TOOLS[tool].read(path, make_scan(COUNT), label_space())


def _objects() -> bytes:
    """Return two objects and their points, as Segments.ai saves them."""
    objects = [{"id": 1, "category_id": 10}, {"id": 2, "category_id": 40}]
    return json.dumps(
        {"annotations": objects, "point_annotations": [0, 1, 2] * (COUNT // 3)}
    ).encode()


def _figures() -> bytes:
    """Return a figure of three points, as Supervisely saves it."""
    points = {"geometryType": "point_cloud", "geometry": {"indices": [1, 2, 7]}}
    objects = [{"key": "a", "classTitle": "car"}]
    return json.dumps({"objects": objects, "figures": [{"objectKey": "a", **points}]}).encode()


def _sensor() -> bytes:
    keys = {key: value for key, value in SMALL.to_dict().items() if value is not None}
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items()).encode()


IMAGE = np.zeros((5, 4, 6), np.float32)
LABELS = [bytes(4 * COUNT), b"\x0a\0\1\0" * 3]
SPACE = yaml.safe_dump(FEW.to_dict(), sort_keys=False).encode()
READERS: dict[str, Callable[[Path], Reader]] = {
    "bin": lambda _: Reader("a.bin", _bin(4), _scan),
    "pcd.bin": lambda _: Reader("a.pcd.bin", _bin(5), _scan),
    "label": lambda _: Reader("a.label", LABELS, lambda p: read_labels(p, COUNT)),
    "npy": lambda _: Reader(
        "a.npy",
        [encode_array(IMAGE), encode_array(IMAGE[:, :1])],
        lambda p: read_array(p, np.float32, (5, None, None)),
    ),
    "ply": lambda folder: Reader("a.ply", _ply(folder), _scan),
    **{
        f"pcd {form}": lambda folder, form=form: Reader("s.pcd", _pcd(folder, form), _scan)
        for form in ("ascii", "binary", "binary_compressed")
    },
    "npy of points": lambda _: Reader("s.npy", structured(_table()), _scan),
    "npz": lambda _: Reader("s.npz", npz(_table()), _scan),
    "npy of rows": lambda _: Reader("s.npy", organised(_table()), _scan),
    "feather": lambda _: Reader("s.feather", feather(_table()), _scan),
    "parquet": lambda _: Reader("s.parquet", parquet(_table()), _scan),
    "las": lambda folder: _las(folder, "a.las"),
    "laz": lambda folder: _las(folder, "a.laz"),
    "e57": _e57,
    "csv with names": lambda _: Reader("s.csv", named_lines(_table()), _scan),
    "pts": lambda _: Reader("s.pts", leica(_table()), _scan),
    "csv": lambda _: Reader("s.csv", lines(_table(), ","), _scan),
    "xyz": lambda _: Reader("s.xyz", lines(_table(), " "), _scan),
    "label of Segments.ai": lambda _: Reader("s.json", [_objects()], _labels_of("segments")),
    "annotation of Supervisely": lambda _: Reader(
        "s.pcd.json", [_figures()], _labels_of("supervisely")
    ),
    "db3": _bag,
    "pcap": _pcap,
    "maker of a pcap": lambda folder: Reader("m.pcap", [_capture(folder)], maker_of),
    "pcap of Velodyne": _velodyne,
    "yaml": lambda _: Reader("labels.yaml", [SPACE, SPACE[: len(SPACE) // 2]], label_space),
    "toml of a sensor": lambda _: Reader("s.toml", [_sensor()], sensor),
    "toml of a recipe": lambda _: Reader(
        "r.toml", [Recipe().to_toml().encode(), b"epochs = 3\n"], recipe
    ),
    "safetensors": lambda folder: Reader("w.safetensors", _safetensors(folder), read_weights),
    "published": lambda _: _published(),
}
"""Functions that make a reader, with valid files in an empty folder, by its name."""
