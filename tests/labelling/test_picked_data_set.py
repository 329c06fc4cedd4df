# SPDX-License-Identifier: MIT
import pytest

from salsanext_cli.errors import FormatError
from salsanext_cli.labelling.picked_data_set import pose_lines


@pytest.fixture
def poses(tmp_path):
    def write(count, end="\n"):
        path = tmp_path / "poses.txt"
        path.write_text("".join(f"{i} 0 0 1{end}" for i in range(count)))
        return path

    return write


def numbers(content: bytes) -> list[int]:
    return [int(line.split()[0]) for line in content.splitlines()]


def test_a_line_for_each_scan_is_in_their_order(poses):
    scans = ["000010", "000020", "000030"]
    assert numbers(pose_lines(poses(3), scans, ["000020", "000030"])) == [1, 2]
    assert pose_lines(poses(3), ["a", "b", "c"], ["c", "a"]) == b"2 0 0 1\n0 0 0 1\n"


def test_otherwise_a_name_is_the_number_of_the_line(poses):
    assert numbers(pose_lines(poses(101), ["000100", "000007"], ["000007", "000100"])) == [7, 100]


def test_empty_lines_and_foreign_line_ends_do_not_count(poses):
    assert pose_lines(poses(2, "\r\n\r\n"), ["a", "b"], ["b"]) == b"1 0 0 1\n"


@pytest.mark.parametrize("wanted", ["000003", "1_5", "-1", "²"])
def test_lines_that_cannot_be_told(poses, wanted):
    with pytest.raises(FormatError, match="3 lines · expected one for each of 2 scans"):
        pose_lines(poses(3), ["000000", wanted], [wanted])
