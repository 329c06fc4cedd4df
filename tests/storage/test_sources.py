# SPDX-License-Identifier: MIT
import pytest
from scans import write_sequence

from salsanext_cli.errors import NoInputError
from salsanext_cli.stages.predict import predict
from salsanext_cli.storage.sources import remembered_scans


@pytest.mark.parametrize("place", ["velodyne", "."])
def test_scans_of_one_sequence_may_move_under_another_name(world, tmp_path, place):
    drive = write_sequence(tmp_path / "drive")
    predict(drive / place, world.out, network=world.network)
    moved = drive.rename(tmp_path / "moved")
    with pytest.raises(NoInputError, match="--dataset"):
        remembered_scans(world.out)
    (scan,) = remembered_scans(world.out, moved / place)
    assert (scan.sequence, scan.stem) == ("drive", "000000")
    assert scan.path == moved / "velodyne/000000.bin"
    assert scan.label_path == moved / "labels/000000.label"
