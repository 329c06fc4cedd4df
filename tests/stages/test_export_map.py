# SPDX-License-Identifier: MIT
import shutil
from dataclasses import replace

import numpy as np
import plyfile
import pytest
from scans import write_array, write_bin
from typer.testing import CliRunner

from salsanext_cli import Scan, label_space, read_labels, read_scan, write_labels
from salsanext_cli.cli.app import app
from salsanext_cli.errors import NOTICE, NoInputError, OutputError, SalsanextError, UsageError
from salsanext_cli.fusion import drive_map
from salsanext_cli.fusion.drive import Drive
from salsanext_cli.fusion.drive_map import MapTask
from salsanext_cli.fusion.poses import encode_poses
from salsanext_cli.option_fields import FusionReach
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.parallel.run_options import Shard
from salsanext_cli.results.paths import find_scans
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.fuse import fuse_results
from salsanext_cli.stages.predict import predict_scans

SPACE = label_space()
FAR = np.array([4e5, 5e6, 30.0])
CAR, BUILDING = 10, 50


def ray_cast(x, walls):
    """Return points that rays of an HDL-64 from (x, 0) hit of walls, and their labels.

    Each wall is at y, from one x to another, 3 m high around the sensor; the last is endless.
    """
    azimuth = (np.arange(2048) + 0.5) / 2048 * 2 * np.pi - np.pi
    elevation = np.radians(3 - 28 * (np.arange(20) + 0.5) / 64)
    elevation, azimuth = (each.ravel() for each in np.meshgrid(elevation, azimuth))
    nearest, labels = np.full(len(azimuth), np.inf), np.zeros(len(azimuth), np.uint32)
    for y, start, end, label in walls:
        with np.errstate(divide="ignore"):
            distance = y / np.sin(azimuth)
        hit = (distance > 0) & (distance < nearest) & (distance < 60)
        place = x + distance * np.cos(azimuth)
        hit &= (place >= start) & (place <= end)
        nearest[hit], labels[hit] = distance[hit], label
    seen = np.isfinite(nearest)
    points = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], 1) * nearest[:, None]
    return points[seen].astype(np.float32), labels[seen]


@pytest.fixture
def street(tmp_path):
    """Return the task of a map of five scans of a parked and a moving car between two walls."""
    poses = np.tile(np.eye(4), (5, 1, 1))
    for i in range(5):
        poses[i, 0, 3] = i
        parked, moving = (5.0, 0, 4, CAR), (-5.0, 4 * i - 6, 4 * i - 4, CAR)
        walls = (parked, moving, (10.0, -99, 99, BUILDING), (-10.0, -99, 99, BUILDING))
        points, labels = ray_cast(i, walls)
        write_bin(tmp_path / f"08/velodyne/{i}.bin", Scan(points, np.zeros(len(points), "f4")))
        write_labels(tmp_path / f"out/sequences/08/predictions/{i}.label", labels)
        write_array(tmp_path / f"out/sequences/08/views/{i}.npy", np.ones(len(points), np.uint16))
    files = tuple(find_scans(tmp_path / "08"))
    drive = Drive(poses, np.zeros(5, np.int64))
    return MapTask(ResultFolder(tmp_path / "out"), files, drive, SPACE, 0.1, 20)


def cars_and_buildings(task):
    """Return whether there is a parked car, a moving one, and a building behind that."""
    columns_of = task.open()
    found = [columns_of(file) for file in task.files]
    assert len(found) == len(task.files)
    places, labels = (np.concatenate([part[name] for part in found]) for name in ("y", "label"))
    moving = labels[places < 0]
    return (labels[places > 4.9] == CAR).any(), (moving == CAR).any(), (moving == BUILDING).any()


def test_moving_objects_leave_no_trail_with_scans_in_reach_of_the_part(street):
    assert cars_and_buildings(street) == (True, False, True)
    assert cars_and_buildings(replace(street, reach=0)) == (True, True, True)
    apart = Drive(street.drive.poses, np.arange(5))
    assert cars_and_buildings(replace(street, drive=apart)) == (True, True, True)


@pytest.fixture
def fused(world):
    """Return a world of a fused drive, far from the origin of its map."""
    folder = world.data / "sequences/08"
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = FAR
    poses[1, 0, 3] += 0.2
    scan = read_scan(world.scan())
    noise = np.random.default_rng(1).normal(0, 0.02, scan.points.shape)
    seen = (scan.points - [0.2, 0, 0] + noise).astype(np.float32)
    write_bin(world.scan(stem="000001"), Scan(seen, scan.intensity))
    (folder / "poses.txt").write_bytes(encode_poses(poses))
    predict_scans(folder, world.out, settings=world.network, extras=("votes",))
    fuse_results(world.out)
    return world


def export(world, **options):
    return export_ply(world.out / "fused", **{"voxel": 0.1} | options)


def map_of(world):
    return world.out / "fused/sequences/08/map.ply"


def test_a_map_holds_the_fused_points_in_the_frame_of_the_poses(fused):
    assert export(fused).done == 2
    data = plyfile.PlyData.read(map_of(fused))
    vertices = data["vertex"]
    assert any(comment.startswith("colour label") for comment in data.comments)
    names = ("label", "probability", "views", "scan", "intensity", "range")
    assert {f"scalar_{name}" for name in names} <= {each.name for each in vertices.properties}
    places = np.stack([vertices[axis] for axis in "xyz"], axis=1)
    assert len(np.unique(np.floor((places - FAR) / 0.1), axis=0)) == len(places)
    for number in (0, 1):
        path = fused.out / f"fused/sequences/08/predictions/00000{number}.label"
        points = read_scan(fused.scan(stem=f"00000{number}")).points + FAR + [0.2 * number, 0, 0]
        of_scan = vertices["scalar_scan"] == number
        apart = np.abs(places[of_scan][:, None] - points).max(axis=2)
        assert apart.min(axis=1).max() < 1e-6
        labels = read_labels(path)[apart.argmin(axis=1)]
        np.testing.assert_array_equal(vertices["scalar_label"][of_scan], labels)
        against = np.load(
            fused.out / f"fused/sequences/08/uncertainty/disagreement/00000{number}.npy"
        )
        np.testing.assert_array_equal(
            vertices["scalar_probability"][of_scan], 1 - against[apart.argmin(axis=1)]
        )
        assert labels.all()


def test_a_map_takes_the_reach_of_the_votes(fused, monkeypatch):
    fuse_results(fused.out, reach=FusionReach(7, 2), options=RunOptions(overwrite=True))
    reaches = []

    class Window(drive_map.DriveWindow):
        def __init__(self, parts, reach, read):
            reaches.append(reach)
            super().__init__(parts, reach, read)

    monkeypatch.setattr(drive_map, "DriveWindow", Window)
    export(fused)
    assert reaches == [7]


def test_parts_of_a_drive_do_not_cover_each_other(world, caplog):
    folder = world.data / "sequences/08"
    for number in range(1, 4):
        shutil.copy(world.scan(), world.scan(stem=f"00000{number}"))
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = 0, 60, 120, 120
    poses[1, :2, :2] = [[0, -1], [1, 0]]  # Otherwise the scans fit in millimetres.
    (folder / "poses.txt").write_bytes(encode_poses(poses))
    predict_scans(folder, world.out, settings=world.network, extras=("votes",))
    fuse_results(world.out)
    caplog.clear()
    caplog.set_level(NOTICE)
    export(world)
    vertices = plyfile.PlyData.read(map_of(world))["vertex"]
    counts = np.bincount(vertices["scalar_part"])
    assert counts[0] == counts[1] == counts[2]
    assert "3 parts" in caplog.text


def test_voxels_too_small_for_the_way_are_refused(fused, monkeypatch):
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 12e3
    drive = Drive(poses, np.zeros(2, np.int64))
    monkeypatch.setattr("salsanext_cli.stages.export_ply.drive_of_map", lambda *_: drive)
    with pytest.raises(UsageError, match=r"12\.0 km") as refused:
        export(fused, voxel=0.01)
    assert refused.value.subject == "--map-voxel"
    assert export(fused, voxel=0.02).done == 2


@pytest.mark.usefixtures("workers_in_process")
def test_workers_change_nothing_and_a_map_of_the_user_is_kept(fused):
    export(fused)
    alone = map_of(fused).read_bytes()
    export(fused, options=RunOptions(jobs=2))
    assert map_of(fused).read_bytes() == alone
    map_of(fused).write_text("mine")
    with pytest.raises(OutputError) as refused:
        export(fused)
    assert refused.value.subject == str(map_of(fused))
    assert map_of(fused).read_text() == "mine"


def test_impossible_maps_are_refused(fused):
    for wrong in (
        {"max_error": 0.1},
        {"options": RunOptions(shard=Shard(1, 2))},
        {"voxel": 0.0},
        {"voxel": float("nan")},
        {"colour": "truth"},
    ):
        with pytest.raises(UsageError, match="--map"):
            export(fused, **wrong)
    with pytest.raises(NoInputError) as refused:
        export_ply(fused.out, voxel=0.1)
    assert "salsanext fuse" in refused.value.hint
    assert not [*fused.out.rglob("map.*")]


def test_an_unreadable_scan_is_named_and_skipped(fused):
    (fused.out / "fused/sequences/08/views/000001.npy").write_bytes(b"no array")
    outcome = export(fused)
    assert [failure.scan.stem for failure in outcome.failures] == ["000001"]
    assert not plyfile.PlyData.read(map_of(fused))["vertex"]["scalar_scan"].any()


def test_the_command_writes_a_map(fused):
    words = ["export-ply", str(fused.out / "fused"), "--map", "--map-voxel", "1"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "map.ply" in result.output
    assert not (map_of(fused).parent / "ply").exists()
    words.remove("--map")
    assert CliRunner().invoke(app, words).exit_code == 2


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("drive.json", '{"scans": 3}'),
        ("drive.json", '{"scans": ["0'),
        ("drive.json", None),
        ("poses.txt", "1 0 0\n"),
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n" * 4),
        ("poses.txt", None),
    ],
)
def test_a_map_needs_the_record_and_the_poses_of_the_fusion(fused, name, content):
    path = fused.out / "fused/sequences/08" / name
    path.unlink() if content is None else path.write_text(content)
    with pytest.raises(SalsanextError, match=name.replace(".", r"\.")):
        export(fused)
