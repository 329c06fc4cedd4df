# SPDX-License-Identifier: MIT
"""Recordings, read back with rerun-sdk: what is in them, and that they are whole."""

import resource
import subprocess
import sys

import numpy as np
import pytest
from evaluated import CAR, MOVING_CAR, ROAD, SPACE, UNKNOWN, World
from scans import make_scan, replace_points

from salsanext_cli import Scan, read_labels, read_scan
from salsanext_cli.errors import OutputError, UsageError
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.report.colours import EMPTY, map_on_dark, screen_colours
from salsanext_cli.results.layout import output_path
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages.export_rrd import export_rrd

pytestmark = pytest.mark.slow
COUNT = 500
KINDS = ("error", "entropy")
MAPPINGS = "VisualizerInstruction:component_map"


@pytest.fixture(autouse=True)
def rerun():
    return pytest.importorskip("rerun", reason="needs rerun-sdk: `make test-slow` installs it")


@pytest.fixture
def world(tmp_path):
    """Return four scans: the second lacks truth and uncertainty, the third all results."""
    world, random = World(tmp_path), np.random.default_rng(0)
    for number in range(4):
        labels = random.choice([0, CAR, ROAD, MOVING_CAR], (2, COUNT))
        stem, known = f"{number:06}", number in (0, 3)
        world.add(stem, labels[0] if known else None, labels[1])
        points = make_scan(COUNT, seed=number)
        write_bin(scan_path(world, stem), points)
        for kind in KINDS if known else ():
            world.put(f"uncertainty/{kind}", stem, random.random(COUNT))
    output_path(world.out, "08", "predictions", "000002").unlink()
    return world


def scan_path(world, stem):
    return world.dataset / f"sequences/08/velodyne/{stem}.bin"


def exported(world, **choice):
    """Export; return the recording."""
    export_rrd(world.out, query=ResultQuery(world.dataset, **choice))
    return world.out / "rrd/08.rrd"


def parts_of(path, *, blueprint=False):
    """Yield all parts of a recording, or of the layout in it."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (store,) = reader.blueprints() if blueprint else reader.recordings()
    yield from reader.store(store=store).stream()


def chunks(path, entity, *, static=False):
    """Return the columns of each part of an entity."""
    parts = [p for p in parts_of(path) if p.entity_path == entity and p.is_static == static]
    batches = [part.to_record_batch() for part in parts]
    return [dict(zip(b.schema.names, b.columns, strict=True)) for b in batches]


def scans_of(path):
    """Return the components of every scan, as arrays, by its number."""
    found = {}
    for columns in chunks(path, "/points"):
        (number,) = columns.pop("scan").to_pylist()
        columns.pop("rerun.controls.RowId")
        found[number] = {name: array_of(cells[0].values) for name, cells in columns.items()}
    return dict(sorted(found.items()))


def array_of(values):
    if hasattr(values, "flatten") and hasattr(values.type, "list_size"):
        return values.flatten().to_numpy().reshape(-1, values.type.list_size)
    return values.to_numpy(zero_copy_only=False)


def rgb_of(packed):
    """Return red, green and blue of colours as rerun packs them, with alpha."""
    return np.stack([packed >> 24, packed >> 16 & 0xFF, packed >> 8 & 0xFF], axis=1)


def test_positions_ids_and_values_are_those_of_the_files(world):
    found = scans_of(exported(world))
    assert [*found] == [0, 1, 3]
    for number, columns in found.items():
        stem = f"{number:06}"
        scan = read_scan(scan_path(world, stem))
        labels = read_labels(output_path(world.out, "08", "predictions", stem))
        np.testing.assert_array_equal(columns["Points3D:positions"], scan.points)
        np.testing.assert_array_equal(columns["Points3D:class_ids"], labels)
        np.testing.assert_array_equal(columns["intensity:value"], scan.intensity)
        assert columns["Points3D:positions"].dtype == columns["range:value"].dtype == np.float32
    for number in (0, 3):
        stem, columns = f"{number:06}", found[number]
        truth = read_labels(world.dataset / f"sequences/08/labels/{stem}.label")
        np.testing.assert_array_equal(columns["truth:class_ids"], truth)
        right = SPACE.to_train(truth) == SPACE.to_train(columns["Points3D:class_ids"])
        judged = truth > 0
        np.testing.assert_array_equal(columns["wrong:value"][judged], ~right[judged])
        assert np.isnan(columns["wrong:value"][~judged]).all()
        for kind in KINDS:
            values = np.load(output_path(world.out, "08", f"uncertainty/{kind}", stem))
            np.testing.assert_array_equal(columns[f"{kind}:value"], values)
            assert columns[f"{kind}:value"].dtype == np.float32


def test_what_a_scan_lacks_is_not_that_of_the_scan_before(world):
    """The viewer takes a component that is not there from the last scan that has it."""
    path = exported(world)
    found = scans_of(path)
    assert {*found[1]} == {*found[0]}
    for name in ("truth:class_ids", "wrong:value", *(f"{kind}:value" for kind in KINDS)):
        assert len(found[1][name]) == 0
    for name in ("truth", "wrong", *KINDS):
        np.testing.assert_array_equal(rgb_of(found[1][f"{name}:colors"]), [EMPTY])
    (ends,) = chunks(path, "/")
    assert ends["scan"].to_pylist() == [2]
    assert ends["Clear:is_recursive"].to_pylist() == [[True]]


def test_colours_are_those_of_pictures(world):
    path = exported(world)
    columns = scans_of(path)[0]
    colours = screen_colours(SPACE)
    for name, ids in (("label", "Points3D:class_ids"), ("truth", "truth:class_ids")):
        expected = colours[SPACE.to_train(columns[ids])]
        np.testing.assert_array_equal(rgb_of(columns[f"{name}:colors"]), expected)
    values = columns["entropy:value"]
    order = np.argsort(values)
    place = [
        np.abs(map_on_dark().astype(int) - c).sum(1).argmin()
        for c in rgb_of(columns["entropy:colors"])[order]
    ]
    assert (np.diff(place) >= 0).all()
    assert place[0] == 0
    assert place[-1] == 255
    (context,) = chunks(path, "/points", static=True)
    (classes,) = context["AnnotationContext:context"][0].as_py()
    infos = [each["class_description"]["info"] for each in classes]
    assert {info["id"]: info["label"] for info in infos} == SPACE.labels
    for info in infos:
        rgb = rgb_of(np.array([info["color"]]))[0]
        np.testing.assert_array_equal(rgb, colours[SPACE.to_train(np.array(info["id"]))])


def test_each_colouring_is_a_view(world):
    path = exported(world)
    names, mapped = set(), set()
    for part in parts_of(path, blueprint=True):
        batch = part.to_record_batch()
        for name in {"ViewBlueprint:display_name", MAPPINGS} & {*batch.schema.names}:
            (cell,) = batch[name].to_pylist()
            if name == MAPPINGS:
                mapped |= {(each["target"], each["source_component"]) for each in cell}
            else:
                names |= {*cell}
    assert names == {"label", "truth", "wrong", *KINDS, "text"}
    assert mapped == {("Points3D:colors", f"{name}:colors") for name in names - {"text"}}
    text = chunks(path, "/text")[0]["TextDocument:text"].to_pylist()
    assert text[0][0].startswith("# 08/000000\n")


def test_odd_points_and_none_are_recorded(world):
    odd = np.array([[0, 0, 0], [np.nan, 1, 1], [5, 0, 0], [np.inf, 0, 0]], np.float32)
    write_bin(scan_path(world, "000000"), Scan(odd, np.zeros(4, np.float32)))
    world.put("uncertainty/entropy", "000000", [np.nan, np.nan, 1, np.nan])
    output_path(world.out, "08", "uncertainty/error", "000000").unlink()
    for path in (world.dataset / "sequences/08/labels", world.out / "sequences/08/predictions"):
        np.array([0, 0, CAR, UNKNOWN], np.uint32).tofile(path / "000000.label")
        (path / "000003.label").write_bytes(b"")
    replace_points(scan_path(world, "000003"), [])
    for kind in KINDS:
        world.put(f"uncertainty/{kind}", "000003", [])
    found = scans_of(exported(world))
    np.testing.assert_array_equal(found[0]["Points3D:positions"], odd)
    assert found[0]["Points3D:class_ids"].tolist() == [0, 0, CAR, UNKNOWN]
    np.testing.assert_array_equal(rgb_of(found[0]["entropy:colors"])[[0, 1, 3]], [EMPTY] * 3)
    assert {name: len(values) for name, values in found[3].items() if len(values)} == {}


def test_the_command_line_of_rerun_finds_a_recording_whole(world):
    path = exported(world)
    for words in (["verify"], ["stats"], ["print"]):
        command = [sys.executable, "-m", "rerun", "rrd", *words, path]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr
    assert "Points3D:positions" in ended.stdout


@pytest.mark.parametrize("room", [0, 5_000, 60_000])
def test_what_cannot_be_written_whole_is_an_error_and_the_older_recording_stays(world, room):
    path = exported(world)
    before = path.read_bytes()
    assert len(before) > room
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"08\.rrd · cannot be written"):
            exported(world)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert [each.name for each in path.parent.iterdir()] == ["08.rrd"]


def test_a_recording_that_is_turned_off_is_an_error(world, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(UsageError, match="RERUN · off · expected on"):
        exported(world)
    assert not [*(world.out / "rrd").iterdir()]
