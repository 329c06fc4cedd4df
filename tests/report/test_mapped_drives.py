# SPDX-License-Identifier: MIT
"""A page shows the top view of a drive if `fuse` has recorded its poses."""

import numpy as np
import pytest
from calls import calls_of
from evaluation_runs import CAR, ROAD, SPACE, World

from salsanext_cli import read_scan
from salsanext_cli.commands.stages.report import read_run
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.report.drive_map import drive_map_picture
from salsanext_cli.report.mapped_drives import drive_maps
from salsanext_cli.report.page.html import html_of
from salsanext_cli.runs.drives.drive_record import drive_record
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection

STEMS = ("a", "b", "c", "d")
PREDICTED = [CAR, ROAD, ROAD, 0]
TURN = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])


@pytest.fixture
def world(tmp_path):
    world = World(tmp_path)
    for stem in STEMS:
        world.add(stem, None, PREDICTED)
    return world


def write_drive(folder, parts):
    """Record a drive whose scans are ten metres apart, each turned by a right angle."""
    poses = np.tile(np.eye(4), (len(STEMS), 1, 1))
    poses[:, :3, :3] = TURN
    poses[:, 0, 3] = 10 * np.arange(len(STEMS))
    drive = Drive(poses, np.array(parts))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "poses.txt").write_bytes(encode_poses(poses))
    (folder / "drive.json").write_bytes(encode_json(drive_record(drive, STEMS)))
    return poses


def run_of(world):
    return read_run(world.out, query=ResultQuery(world.dataset))[0]


@pytest.mark.parametrize("place", ["sequences/08", "fused/sequences/08"])
def test_points_and_trajectory_are_in_the_frame_of_the_drive(world, place):
    poses = write_drive(world.out / place, [0, 0, 1, 0])
    run = run_of(world)
    with calls_of(drive_map_picture) as calls:
        (drawn,) = drive_maps(run).maps
    assert drawn.address.startswith("data:image/png;base64,")
    assert "3 scans" in drawn.description
    # The third scan is in another part, cars are movable, and the last point has no label.
    expected = [
        poses[i, :3, :3] @ point + poses[i, :3, 3]
        for i, stem in enumerate(STEMS)
        for point in read_scan(world.dataset / f"sequences/08/velodyne/{stem}.bin").points[1:3]
        if i != 2
    ]
    (call,) = calls
    np.testing.assert_allclose(call["points"], expected, atol=1e-4)
    np.testing.assert_allclose(call["trajectory"], poses[[0, 1, 3], :3, 3])
    assert [name for name, _ in call["legend"]] == ["road"]
    assert SPACE.names.index("road") > 0


def test_a_run_that_was_not_fused_has_neither_a_map_nor_a_problem(world):
    drawn = drive_maps(run_of(world))
    assert (drawn.maps, drawn.problems) == ([], [])


def test_a_drive_without_a_map_has_its_reason_on_the_page(world, caplog):
    folder = world.out / "sequences/08"
    poses = folder / "poses.txt"

    def problem():
        run = run_of(world)
        drawn = drive_maps(run)
        assert drawn.maps == []
        (text,) = drawn.problems
        assert caplog.records[-1].getMessage().replace("\nhint: ", "; ") == text
        page = html_of(run, None, [], {}, [], {})
        assert 'class="map"' not in page
        assert text in page
        return text

    write_drive(folder, [0, 1, 2, 3])
    assert "has results of only 1 scan" in problem()
    write_drive(folder, [0, 0, 0, 0])
    poses.write_text("1 2 3\n")
    assert str(poses) in problem()
    poses.unlink()
    assert f"{poses}: is missing" in problem()


def test_a_single_selected_scan_of_a_drive_has_neither_a_map_nor_a_problem(world):
    write_drive(world.out / "sequences/08", [0, 0, 0, 0])
    query = ResultQuery(world.dataset, ScanSelection(limit=1))
    drawn = drive_maps(read_run(world.out, query=query)[0])
    assert (drawn.maps, drawn.problems) == ([], [])
    for path in sorted(world.out.rglob("*.label"))[1:]:
        path.unlink()
    (problem,) = drive_maps(run_of(world)).problems
    assert "has results of only 1 scan" in problem


def test_the_map_is_on_the_page(world):
    write_drive(world.out / "sequences/08", [0, 0, 0, 0])
    run = run_of(world)
    page = html_of(run, None, [], {}, [], {})
    assert page.count('class="map"') == 1
    assert "Top view of 08: 4 scans" in page
