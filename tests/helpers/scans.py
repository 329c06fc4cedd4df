# SPDX-License-Identifier: MIT
"""Small scans, data sets and networks that many tests need."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import nn

from salsanext_cli import LabelSpace, Scan, Sensor, label_space, read_scan, write_labels
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.registry import ARCHITECTURES, build
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.ply import write_ply
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.runs.scans.scan_folders import FILE_LISTS

SMALL = Sensor(
    "small",
    fov_up=3.0,
    fov_down=-25.0,
    height=16,
    width=128,
    range_noise=0.02,
    intensity_noise=0.02,
)
"""Sensor with the field of view of an HDL-64 and few pixels, for networks in milliseconds."""
IN_BYTES = replace(SMALL, intensity_scale=255.0)
"""Sensor with intensities from 0 to 255."""


HOUSING = 300
"""Number of points that `add_housing` adds to a scan."""


def add_housing(data: Path) -> None:
    """Begin each scan of a data set with points on a housing, 0.3 m from the sensor."""
    directions = np.random.default_rng(0).normal(size=(HOUSING, 3))
    directions *= 0.3 / np.linalg.norm(directions, axis=1, keepdims=True)
    for path in data.rglob("*.bin"):
        scan = read_scan(path)
        points = np.concatenate([directions.astype(np.float32), scan.points])
        intensity = np.concatenate([np.full(HOUSING, 0.5, np.float32), scan.intensity])
        write_bin(path, Scan(points, intensity))


def refused(kind: type[SalsanextError], subject: object, *call: Any, **options: Any) -> Any:
    """Expect an error with a subject: of a function and its arguments, else of the body of `with`.

    The latter gives what `pytest.raises` gives.
    """

    @contextmanager
    def refusing() -> Iterator[pytest.ExceptionInfo[SalsanextError]]:
        with pytest.raises(kind) as caught:
            yield caught
        assert caught.value.subject == str(subject)

    if not call:
        return refusing()
    function, *arguments = call
    with refusing() as caught:
        function(*arguments, **options)
    return caught


def named_by_hint(path: Path) -> tuple[str, ...]:
    """Return the names of columns in the hint of the error with which a scan is refused."""
    with pytest.raises(SalsanextError) as caught:
        read_scan(path)
    (names,) = re.findall(r'columns="([\w,]+)"', caught.value.hint)
    return tuple(names.split(","))


def make_scan(count: int = 1500, seed: int = 0) -> Scan:
    """Return points on the ground and on walls around the sensor, in the order of its turn."""
    random = np.random.default_rng(seed)
    azimuth = np.sort(random.uniform(-np.pi, np.pi, count))
    elevation = np.radians(random.uniform(-25, 3, count))
    wall = 12 + 8 * np.sin(3 * azimuth + seed) + random.normal(0, 0.05, count)
    ground = -1.7 / np.minimum(np.sin(elevation), -1e-3)
    distance = np.minimum(wall / np.cos(elevation), ground)
    flat = distance * np.cos(elevation)
    points = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    intensity = random.random(count).astype(np.float32)
    return Scan(np.stack(points, axis=1).astype(np.float32), intensity)


def write_bin(path: Path, scan: Scan) -> None:
    """Write a scan as float32 x, y, z, intensity, with its folders."""
    write_bytes(path, encode_bin(scan))


def write_array(path: Path, array: npt.ArrayLike) -> None:
    """Write an array as a `.npy` file, with its folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, array)


def replace_points(path: Path, points: npt.ArrayLike) -> Path:
    """Replace a `.bin` scan by a PLY of points (N, 3)."""
    table = np.array(points, np.float32).reshape(-1, 3)
    path.unlink()
    write_ply(path.with_suffix(".ply"), dict(zip("xyz", table.T, strict=True)))
    return path.with_suffix(".ply")


def write_sequence(
    folder: Path,
    stems: Iterable[str] = ("000000",),
    *,
    count: int = 1500,
    labels: bool = True,
    seed: int = 0,
) -> Path:
    """Write a sequence of scans and labels of all classes in SemanticKITTI's layout."""
    space = label_space()
    for number, stem in enumerate(stems, start=seed):
        write_bin(folder / "velodyne" / f"{stem}.bin", make_scan(count, number))
        if labels:
            train = np.random.default_rng(number).integers(0, space.class_count, count)
            write_labels(folder / "labels" / f"{stem}.label", space.to_raw(train))
    return folder


@contextmanager
def salsanext_of(**channels: Any) -> Iterator[None]:
    """Have other channels in the network that is called salsanext, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ARCHITECTURES, "salsanext", partial(SalsaNext, **channels))
        yield


def lively(module: nn.Module, seed: int = 0) -> nn.Module:
    """Give an untrained network the statistics and logits of a trained one."""
    random = torch.Generator().manual_seed(seed)
    for name, values in module.state_dict().items():
        if name.endswith("running_var"):
            values.uniform_(0.5, 2.0, generator=random)
        elif name.endswith("running_mean"):
            values.normal_(0, 0.2, generator=random)
        elif values.is_floating_point() and values.dim() > 1:
            fan = values[0].numel()
            values.normal_(0, (2 / fan) ** 0.5, generator=random)
        elif name.endswith("bias"):
            values.normal_(0, 0.1, generator=random)
    return module.eval()


def write_weights(
    path: Path,
    *,
    space: LabelSpace | None = None,
    sensor: Sensor = SMALL,
    dropout: float = 0.2,
    error: ErrorModel | None = None,
    seed: int = 0,
) -> Path:
    """Write a weights file of a random network."""
    space = space or label_space()
    architecture = {"name": "salsanext", "class_count": space.class_count, "dropout": dropout}
    card = WeightsCard(architecture, space, sensor, description="random", error=error)
    save_weights(path, lively(build(architecture), seed), card)
    return path


def files_below(folder: Path) -> dict[str, bytes]:
    """Return the content of every file below a folder by its relative name.

    The lists of written files are skipped, since they contain times.
    """
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and FILE_LISTS not in path.parts
    }


def labels_below(folder: Path) -> dict[str, bytes]:
    """Return the content of every `.label` file below a folder."""
    return {name: data for name, data in files_below(folder).items() if name.endswith(".label")}


def share_alike(folder: Path, expected: Path) -> float:
    """Return the share of points of two folders of results with the same label."""
    labels, others = labels_below(folder), labels_below(expected)
    assert labels.keys() == others.keys()
    pairs = [(np.frombuffer(labels[n], "<u4"), np.frombuffer(others[n], "<u4")) for n in labels]
    return sum(int((a == b).sum()) for a, b in pairs) / sum(len(a) for a, _ in pairs)


def real_scans(real_data: Path) -> list[Path]:
    """Return the real `.bin` files in rows of float32, without those that are no scans."""
    found = sorted((real_data / "data").rglob("*.bin"))
    return [path for path in found if not {"not_scans", "planar"} & {*path.parts}]


def real_columns(path: Path) -> int:
    """Return the number of columns of a real `.bin` file."""
    return 5 if "five" in path.name or path.name.endswith(".pcd.bin") else 4


def make_empty(root: Path, *names: str) -> None:
    """Write empty files below a root, whose readers are not called."""
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
