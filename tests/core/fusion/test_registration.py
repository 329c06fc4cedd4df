# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from street_poses import along, street

from salsanext_cli import read_scan
from salsanext_cli.core.fusion.registration import register
from salsanext_cli.io.poses import pose_readings

pytest.importorskip("small_gicp")
WAY = along(0, 2, 4, 6, 8, 10)
SEEN = street(WAY)
ELSEWHERE = np.random.default_rng(1).uniform([-30, -15, -1.7], [30, 15, 2], (8000, 3))


def test_the_way_is_found_from_the_scans_and_a_scan_elsewhere_begins_a_part():
    drive = register(SEEN(number) for number in range(len(WAY)))
    np.testing.assert_allclose(drive.poses[:, :3, 3], WAY[:, :3, 3], atol=0.1)
    np.testing.assert_allclose(drive.poses[:, :3, :3], WAY[:, :3, :3], atol=0.01)
    assert not drive.parts.any()
    assert register([]).poses.shape == (0, 4, 4)
    drive = register([SEEN(0), SEEN(1), ELSEWHERE, ELSEWHERE, ELSEWHERE])
    assert drive.parts.tolist() == [0, 0, 1, 1, 1]
    assert drive.poses[2, 0, 3] > 900


@pytest.mark.parametrize("bad", [np.zeros((10, 3)), ELSEWHERE, np.full((500, 3), np.nan)])
def test_a_drive_goes_on_behind_a_scan_that_shows_nothing(bad):
    scans = [bad if number == 3 else SEEN(number) for number in range(len(WAY))]
    drive = register(scans)
    assert drive.parts.tolist() == [0, 0, 0, 1, 0, 0]
    good = [0, 1, 2, 4, 5]
    np.testing.assert_allclose(drive.poses[good, :3, 3], WAY[good, :3, 3], atol=0.1)


@pytest.mark.real
@pytest.mark.parametrize(("drive", "start"), [("0004", 28), ("0001", 20)])
def test_a_real_drive_may_begin_in_motion(real_data, drive, start):
    folder = real_data / "data/drives/sequences" / drive
    stems = [f"{number:06d}" for number in range(start, start + 4)]
    stems_of_all = sorted(path.stem for path in (folder / "velodyne").iterdir())
    true = pose_readings(folder / "poses.txt", stems_of_all, stems)[0]
    clouds = (read_scan(folder / f"velodyne/{stem}.bin").points for stem in stems)
    found = register(points[np.isfinite(points).all(axis=1)] for points in clouds)
    steps = [np.linalg.inv(poses[:-1]) @ poses[1:] for poses in (true, found.poses)]
    assert np.linalg.norm(steps[0][:, :3, 3], axis=1).min() > 2
    np.testing.assert_allclose(steps[1][:, :3, 3], steps[0][:, :3, 3], atol=0.3)
    assert not found.parts.any()
