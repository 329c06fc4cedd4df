# SPDX-License-Identifier: MIT
"""Which scans go into which recording, and what is refused; rerun-sdk is not needed."""

from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest
from evaluated import CAR, MOVING_CAR, ROAD, World

from salsanext_cli import read_labels, read_scan
from salsanext_cli.errors import OutputError
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.results.paths import output_path
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages import export_rrd as stage
from salsanext_cli.stages.export_rrd import export_rrd

CONTENT = b"whole"


@dataclass
class Recorded:
    """A recording as the stage asks for it."""

    name: str
    views: list[str]
    scales: dict[str, tuple[float, float]]
    scans: list[tuple] = field(default_factory=list)


@pytest.fixture
def world(tmp_path):
    """Return four scans of two sequences; one has no truth, one no results."""
    world = World(tmp_path)
    world.add("000000", [CAR, ROAD], [CAR, CAR], sequence="00")
    world.add("000000", [CAR, MOVING_CAR], [CAR, ROAD])
    world.add("000001", [CAR, ROAD], None)
    world.add("000002", None, [ROAD, ROAD])
    world.put("uncertainty/entropy", "000002", [0.5, 1.5])
    return world


@pytest.fixture
def recorded(monkeypatch):
    """Take note of recordings, by name, instead of writing them."""
    found: dict[str, Recorded] = {}

    @contextmanager
    def recording(file, name, colourings, space):
        scales = {column: colours.scale for column, colours in colourings.items()}
        found[name] = Recorded(name, [*colourings], scales)
        yield lambda *scan: found[name].scans.append(scan)
        file.write(CONTENT)

    monkeypatch.setattr(stage, "import_rerun", lambda: None)
    monkeypatch.setattr(stage, "recording", recording)
    return found


def export(world, selection=ScanSelection()):
    return export_rrd(world.out, query=ResultQuery(world.dataset, selection))


def written(world):
    """Return the content of every file in the folder of the recordings."""
    folder = world.out / "rrd"
    return {path.name: path.read_bytes() for path in folder.iterdir()} if folder.is_dir() else {}


def test_each_sequence_has_a_recording_of_what_is_known_of_its_scans_in_the_same_views(
    world, recorded
):
    outcome = export(world)
    assert (outcome.done, outcome.failures) == (3, ())
    assert [scan.stem for scan in outcome.missing.scans] == ["000001"]
    assert written(world) == {"00.rrd": CONTENT, "08.rrd": CONTENT}
    assert [*recorded] == ["öut/00", "öut/08"]
    first, second = recorded["öut/08"].scans
    assert (first[0], second[0]) == (0, 2)
    for (_, text, points, columns), stem in ((first, "000000"), (second, "000002")):
        assert text.startswith(f"# 08/{stem}\n")
        scan = read_scan(world.dataset / f"sequences/08/velodyne/{stem}.bin")
        np.testing.assert_array_equal(points, scan.points)
        np.testing.assert_array_equal(columns["intensity"], scan.intensity)
        labels = read_labels(output_path(world.out, "08", "predictions", stem))
        np.testing.assert_array_equal(columns["label"], labels)
    assert first[3]["truth"].tolist() == [CAR, MOVING_CAR]
    assert first[3]["wrong"].tolist() == [0, 1]
    assert {*second[3]} == {"intensity", "range", "label", "entropy"}
    assert second[3]["entropy"].tolist() == [0.5, 1.5]
    for each in recorded.values():
        assert each.views == ["label", "truth", "wrong", "entropy"]
        assert each.scales["entropy"] == pytest.approx((0.51, 1.49))
    (_, text, *_), (_, other, *_) = recorded["öut/08"].scans
    assert text.splitlines()[2:] == ["- label", "- truth", "- wrong", "- no entropy"]
    scale = "- entropy viridis 0.51 1.49"
    assert other.splitlines()[2:] == ["- label", "- no truth", "- no wrong", scale]


def test_a_scan_that_cannot_be_read_is_left_out_and_named(world, recorded):
    broken = output_path(world.out, "08", "predictions", "000000")
    broken.write_bytes(broken.read_bytes() + b"1234")
    outcome = export(world)
    assert (outcome.done, len(outcome.failures)) == (2, 1)
    assert str(broken) in outcome.failures[0].reason
    assert [scan[0] for scan in recorded["öut/08"].scans] == [2]


def test_a_recording_that_fails_leaves_no_part_of_a_file(world, recorded, monkeypatch):
    @contextmanager
    def failing(file, name, colourings, space):
        yield lambda *scan: None
        file.write(CONTENT)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(stage, "recording", failing)
    with pytest.raises(OutputError, match=r"00\.rrd: cannot be written: no space left on device"):
        export(world)
    assert written(world) == {}


def test_recordings_of_others_are_kept_and_ones_own_replaced(world, recorded):
    export(world)
    assert export(world).done == 3
    mine = world.out / "rrd/08.rrd"
    mine.write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"08\.rrd: .*and is kept"):
        export(world)
    assert mine.read_bytes() == b"mine"
    recorded.clear()
    assert export(world, selection=ScanSelection(sequences=("00",))).done == 1
    assert [*recorded] == ["öut/00"]


def test_a_recording_that_appears_meanwhile_is_kept(world, recorded, monkeypatch):
    mine, fake = world.out / "rrd/00.rrd", stage.recording

    @contextmanager
    def slow(*given):
        with fake(*given) as log_scan:
            yield log_scan
        mine.write_bytes(b"mine")

    monkeypatch.setattr(stage, "recording", slow)
    with pytest.raises(OutputError, match=r"00\.rrd"):
        export(world)
    assert written(world) == {"00.rrd": b"mine"}
