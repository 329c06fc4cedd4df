# SPDX-License-Identifier: MIT
"""Plug-ins: the distribution that the page plug-ins.md shows, and distributions with mistakes."""

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import called, only_json
from scans import SMALL, labels_below, lively, make_scan, refused, write_bin

from salsanext_cli import Scan, label_space, load_network, read_scan
from salsanext_cli.core.errors import FormatError, UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.registry import build, described, plugged_networks
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.plug_ins import plug_in_packages
from salsanext_cli.io.formats import plugged_formats
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.label_spaces import plugged_label_spaces
from salsanext_cli.io.weights.weights import read_weights, save_weights
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.recipe import Recipe

PAGE = (Path(__file__).parents[2] / "docs/how-to/plug-ins.md").read_text("utf-8")
POINT = np.dtype([("xyz", "<f4", 3), ("intensity", "u1"), ("label", "<u2")])
LOOKUPS = (plugged_formats, plugged_networks, plugged_label_spaces)
ORIGIN = "radian-lidar 1.0"


def blocks(language: str) -> list[str]:
    return re.findall(f"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def install(site, modules, points, name):
    """Write modules and the metadata of a distribution as `pip install` does."""
    info = site / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [
        line
        for group, named in points.items()
        for line in (f"[{group}]", *(f"{n} = {target}" for n, target in named.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    for file, text in modules.items():
        (site / file).write_text(text)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return a folder with the distribution of the page."""
    modules = {re.match(r"# (\S+)\n", body)[1]: body for body in blocks("python")}
    (body,) = blocks("toml")
    project = tomllib.loads(body)["project"]
    install(tmp_path / "site", modules, project["entry-points"], project["name"])
    return tmp_path / "site"


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Forget plug-ins and warnings before and after a test."""
    before = {*sys.modules}
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")
    for function in (*LOOKUPS, warn_once):
        function.cache_clear()
    yield
    for function in LOOKUPS:
        function.cache_clear()
    for name in {*sys.modules} - before:
        if name.startswith(("radian", "odd")):
            del sys.modules[name]


@pytest.fixture
def plugged(site: Path, clean: None, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install the distribution of the page in this process."""
    monkeypatch.syspath_prepend(site)
    return site


@pytest.fixture
def weights(plugged: Path, tmp_path: Path) -> Path:
    """Return weights of the page's network and classes."""
    architecture = described("radian-net", class_count=3, dropout=0.2)
    card = WeightsCard(architecture, label_space("radian-two"), SMALL)
    save_weights(tmp_path / "w.safetensors", lively(build(architecture)), card)
    return tmp_path / "w.safetensors"


def write_rad(path: Path, scan: Scan, seed: int = 0) -> np.ndarray:
    """Write a scan as the page's format, and return its records."""
    path.parent.mkdir(parents=True, exist_ok=True)
    points = np.zeros(len(scan), POINT)
    points["xyz"], points["intensity"] = scan.points, scan.intensity * 255
    points["label"] = np.random.default_rng(seed).choice([0, 7, 9], len(scan))
    path.write_bytes(b"RAD1" + points.tobytes())
    return points


def test_a_format_of_40_lines_is_read_predicted_filtered_and_labelled(weights, tmp_path):
    (code,) = [body for body in blocks("python") if "FORMAT = " in body]
    assert len([line for line in code.splitlines()[1:] if line]) <= 40
    records = write_rad(tmp_path / "rad/velodyne/0.rad", make_scan())
    scan = read_scan(tmp_path / "rad/velodyne/0.rad")
    np.testing.assert_array_equal(scan.points, records["xyz"])
    intensity = np.float32(records["intensity"]) / np.float32(255)
    np.testing.assert_array_equal(scan.intensity, intensity)
    write_bin(tmp_path / "bin/velodyne/0.bin", scan)
    network = ("--weights", weights, "--device", "cpu")
    for kind in ("rad", "bin"):
        called("predict", tmp_path / kind, tmp_path / f"out-{kind}", *network, "--objects")
    of_rad, of_bin = (
        read_labels(tmp_path / f"out-{kind}/sequences/{kind}/predictions/0.label")
        for kind in ("rad", "bin")
    )
    np.testing.assert_array_equal(of_rad, of_bin)
    assert {*np.unique(of_rad & 0xFFFF)} >= {7, 9}

    called("filter", tmp_path / "out-rad", tmp_path / "still", "--drop", "tram")
    kept = (tmp_path / "still/sequences/rad/velodyne/0.rad").read_bytes()
    assert kept == b"RAD1" + records[of_rad & 0xFFFF != 9].tobytes()

    (tmp_path / "edited").mkdir()
    write_rad(tmp_path / "edited/0.rad", make_scan(), seed=1)
    edited = np.random.default_rng(1).choice([0, 7, 9], len(scan))
    options = ("--label-space", "radian-two", "--json")
    called("import-labels", tmp_path / "edited", tmp_path / "rad", *options)
    np.testing.assert_array_equal(read_labels(tmp_path / "rad/labels/0.label"), edited)


def test_the_packages_of_plug_ins_are_those_of_their_entry_points(plugged):
    assert "radian-lidar" in plug_in_packages()


def test_damage_belongs_to_one_scan(weights, tmp_path):
    for number in range(2):
        write_rad(tmp_path / f"rad/velodyne/{number}.rad", make_scan(seed=number), number)
    with (tmp_path / "rad/velodyne/1.rad").open("ab") as file:
        file.write(b"cut")
    network = ("--weights", weights, "--device", "cpu")
    words = ("predict", tmp_path / "rad", tmp_path / "out", *network, "--json")
    found = only_json(called(*words, status=1))
    assert (found["done"], found["failures"][0]["code"]) == (1, "format")
    (tmp_path / "rad/velodyne/1.rad").write_bytes(b"no")
    with pytest.raises(FormatError, match="does not begin with RAD1"):
        read_scan(tmp_path / "rad/velodyne/1.rad")


@pytest.mark.usefixtures("plugged")
def test_the_first_bytes_reveal_a_wrong_suffix(tmp_path):
    write_rad(tmp_path / "0.rad", make_scan(), 0)
    with pytest.raises(FormatError) as caught:
        read_scan((tmp_path / "0.rad").rename(tmp_path / "0.bin"))
    assert ORIGIN in caught.value.problem
    assert caught.value.hint == "rename it to .rad"


@pytest.mark.usefixtures("plugged")
def test_errors_and_models_list_plug_ins_with_their_distribution(tmp_path):
    (tmp_path / "scan.dat").write_bytes(b"data")
    assert f".rad ({ORIGIN})" in called("inspect", tmp_path / "scan.dat", status=1).stderr
    with pytest.raises(UsageError) as caught:
        label_space("radian-three")
    assert f"radian-two ({ORIGIN})" in caught.value.expected
    with pytest.raises(UsageError) as caught:
        build({"name": "radian"})
    assert f"radian-net ({ORIGIN})" in caught.value.expected
    expected = [("format", "radian"), ("network", "radian-net"), ("label space", "radian-two")]
    printed = only_json(called("models", "--json"))
    listed = printed["plug_ins"]
    assert printed["models"] == ["salsanext", "radian-net"]
    assert [(each["kind"], each["name"]) for each in listed] == expected
    assert {each["distribution"] for each in listed} == {ORIGIN}
    shown = called("models").stdout
    assert all(name in shown and ORIGIN in shown for _, name in expected)


@pytest.mark.slow
def test_processes_of_a_run_see_plug_ins(weights, site, tmp_path):
    for number in range(3):
        write_rad(tmp_path / f"rad/velodyne/{number}.rad", make_scan(seed=number), number)
    network = ("--weights", weights, "--device", "cpu", "--json")
    called("predict", tmp_path / "rad", tmp_path / "here", *network)
    workers = ("--jobs", "2")
    install(site, {}, {"salsanext.formats": {"odd": "odd_absent:FORMAT"}}, "zz-odd")
    command = [sys.executable, "-m", "salsanext_cli", "predict", tmp_path / "rad"]
    done = subprocess.run(
        [*map(str, (*command, tmp_path / "out", *network, *workers))],
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["done"] == 3
    assert done.stderr.count("zz-odd") == 1  # Not once in each process
    assert labels_below(tmp_path / "out") == labels_below(tmp_path / "here")


@pytest.mark.parametrize("engine", ["torch", "openvino"])
@pytest.mark.usefixtures("own_cache")
def test_weights_name_the_distribution_of_their_network(weights, site, engine):
    network = load_network(weights, "cpu", engine=engine)
    assert network.card.architecture["distribution"] == ORIGIN
    # Compiled graphs are not reused if the code changes but not the version.
    (site / "radian_network.py").write_text((site / "radian_network.py").read_text() + "# new\n")
    changed = load_network(weights, "cpu", engine=engine)
    assert changed.backend.code != network.backend.code
    sys.path.remove(str(site))
    plugged_networks.cache_clear()
    with pytest.raises(WeightsError) as caught:
        load_network(weights, "cpu", engine=engine)
    assert ORIGIN in caught.value.problem
    assert ORIGIN in caught.value.hint
    assert "salsanext" in caught.value.expected


@pytest.mark.usefixtures("plugged")
def test_a_training_begins_with_a_network_of_a_plug_in(tmp_path):
    space = label_space("radian-two")
    module, card = initial_network(None, space, Recipe(architecture="radian-net"), SMALL)
    save_weights(tmp_path / "w.safetensors", module, card)
    read, again = read_weights(tmp_path / "w.safetensors")
    assert type(read).__name__ == "RadianNet"
    expected = described("radian-net", class_count=3, dropout=0.2)
    assert again.architecture == card.architecture == expected
    assert again.space.movable.tolist() == [False, False, True]


GOOD = "from salsanext_cli.io.formats import Format\nFORMAT = Format(('.odd',), print)\n"
ODD_FORMAT = "odd_plug_in:FORMAT"
ODD = {"formats": {"odd": ODD_FORMAT}}
MISTAKES: dict[str, tuple[str, dict[str, dict[str, str]], str]] = {
    "no module": ("", {"formats": {"odd": "odd_absent:FORMAT"}}, "ModuleNotFoundError"),
    "no object": ("", {"networks": {"odd": "odd_plug_in:Net"}}, "AttributeError"),
    "an error": ("1 / 0", {"label_spaces": {"odd": "odd_plug_in:SPACE"}}, "ZeroDivisionError"),
    "a built-in network": ("Net = print", {"networks": {"salsanext": "odd_plug_in:Net"}}, "taken"),
    "a built-in space": ("S = 1", {"label_spaces": {"coarse": "odd_plug_in:S"}}, "taken"),
    "a built-in format": (GOOD, {"formats": {"ply": "odd_plug_in:FORMAT"}}, "taken"),
    "a built-in suffix": (GOOD.replace(".odd", ".scan.bin"), ODD, ".scan.bin"),
    "a suffix of labels": (GOOD.replace(".odd", ".label"), ODD, ".label"),
    "an exit": ("import sys; sys.exit(3)", {"formats": {"odd": "odd_plug_in:F"}}, "SystemExit"),
    "no suffix": (GOOD.replace(".odd", "odd"), ODD, "dot"),
    "no format": ("FORMAT = 1", ODD, "int"),
    "no network": ("Net = 1", {"networks": {"odd": "odd_plug_in:Net"}}, "int"),
    "no label space": ("S = {}", {"label_spaces": {"odd": "odd_plug_in:S"}}, "dict"),
    "one of the page": (GOOD, {"formats": {"radian": "odd_plug_in:FORMAT"}}, "taken"),
    "a suffix of the page": (GOOD.replace(".odd", ".rad"), {"formats": {"zz": ODD_FORMAT}}, ".rad"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_plug_in_with_a_mistake_is_one_warning(plugged, tmp_path, caplog, mistake):
    module, groups, problem = MISTAKES[mistake]
    points = {f"salsanext.{kind}": named for kind, named in groups.items()}
    install(plugged, {"odd_plug_in.py": module}, points, "zz-odd")  # sorted after the page's
    for _ in range(2):
        with pytest.raises(FormatError):
            read_scan(tmp_path / "scan.unknown")
        with pytest.raises(UsageError):
            label_space("unknown")
        with pytest.raises(UsageError):
            build({"name": "unknown"})
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert problem in record.getMessage()
    assert "zz-odd 1.0" in record.getMessage()
    # Other plug-ins and built-in objects still work.
    assert [[*lookup()] for lookup in LOOKUPS] == [["radian"], ["radian-net"], ["radian-two"]]
    assert label_space("coarse").class_count == 8
    assert build({"name": "salsanext"}).stride == (16, 16)


@pytest.mark.usefixtures("clean")
def test_an_interrupted_import_of_a_plug_in_is_no_mistake_of_it(tmp_path, monkeypatch):
    module = "try: raise KeyboardInterrupt\nexcept KeyboardInterrupt: raise ImportError"
    points = {"salsanext.formats": {"odd": ODD_FORMAT}}
    install(tmp_path / "site", {"odd_plug_in.py": module}, points, "zz-odd")
    monkeypatch.syspath_prepend(tmp_path / "site")
    with pytest.raises(KeyboardInterrupt):
        plugged_formats()


@pytest.mark.usefixtures("clean")
def test_a_plug_in_that_returns_no_scan_or_no_network_is_refused(tmp_path, monkeypatch):
    named = {"formats": {"odd": ODD_FORMAT}, "networks": {"odd": "odd_plug_in:Net"}}
    points = {f"salsanext.{kind}": targets for kind, targets in named.items()}
    module = f"{GOOD}\ndef Net(**_): return 1"
    install(tmp_path / "site", {"odd_plug_in.py": module}, points, "zz-odd")
    monkeypatch.syspath_prepend(tmp_path / "site")
    (tmp_path / "scan.odd").write_bytes(b"1")
    refused(FormatError, tmp_path / "scan.odd", read_scan, tmp_path / "scan.odd")
    with pytest.raises(UsageError, match=r"zz-odd 1\.0"):
        build({"name": "odd", "class_count": 3})


@pytest.mark.usefixtures("clean")
def test_a_run_without_need_of_plug_ins_imports_none(tmp_path, monkeypatch, caplog):
    points = {f"salsanext.{k}": {"odd": "odd_plug_in:X"} for k in ("formats", "networks")}
    install(tmp_path / "site", {"odd_plug_in.py": "1 / 0"}, points, "zz-odd")
    monkeypatch.syspath_prepend(tmp_path / "site")
    write_bin(tmp_path / "seq/velodyne/0.bin", make_scan())
    called("inspect", tmp_path / "seq")
    called("predict", "--help")
    assert build({"name": "salsanext"}).stride == (16, 16)
    assert "odd_plug_in" not in sys.modules
    assert not [record for record in caplog.records if "zz-odd" in record.getMessage()]


def test_the_table_of_formats_needs_neither_numpy_nor_readers():
    code = "import salsanext_cli.io.formats, sys\n"
    code += "print({'numpy', 'importlib.metadata'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
