# SPDX-License-Identifier: MIT
"""Recordings, read back with rerun-sdk: what is in them, and that they are whole."""

import numpy as np
import pytest
from evaluated import CAR, MOVING_CAR, ROAD, SPACE, World
from scans import make_scan, write_bin

from salsanext_cli import read_labels, read_scan
from salsanext_cli.errors import UsageError
from salsanext_cli.report.colours import EMPTY
from salsanext_cli.results.paths import output_path
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages.export_rrd import export_rrd

pytestmark = pytest.mark.slow
COUNT = 500
KINDS = ("error", "entropy")


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


def chunks(path, entity):
    """Return the columns of each part of an entity."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (store,) = reader.recordings()
    parts = [p for p in reader.store(store=store).stream() if p.entity_path == entity]
    batches = [part.to_record_batch() for part in parts if not part.is_static]
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


def test_a_recording_that_is_turned_off_is_an_error(world, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(UsageError, match=r"RERUN: off \(expected on"):
        exported(world)
    assert not [*(world.out / "rrd").iterdir()]
