# SPDX-License-Identifier: MIT
"""Consecutive scans that a guarantee counts as if they were independent."""

from pathlib import Path

import pytest

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.tuning.consecutive import consecutive_warning, stretches

PAGE = Path(__file__).parents[3] / "docs/reference/warnings.md"


def files(sequence, *stems):
    return [
        ScanFile(sequence=sequence, stem=stem, path=Path(f"/{sequence}/{stem}.bin"))
        for stem in stems
    ]


@pytest.mark.parametrize(
    ("stems", "count"),
    [
        (["000000", "000001", "000002"], 1),
        (["000002", "000000", "000001"], 1),
        (["000000", "000001", "000100", "000101", "000300"], 3),
        (["000000", "000005", "000010"], 3),
        (["frame9", "frame10"], 1),
        (["north", "south"], 2),
        # Times in µs and ns, a tenth of a second and then a minute apart
        (["lidar_1526915243047392", "lidar_1526915243147392", "lidar_1526915303047392"], 2),
        (["315967811660132000", "315967811760132000"], 1),
        # Numbers of six digits are no times.
        (["100000", "100002"], 2),
    ],
)
def test_a_stretch_ends_where_the_next_number_or_a_second_is_missing(stems, count):
    assert stretches(files("08", *stems)) == count


def test_sequences_are_apart():
    assert stretches([*files("00", "000000"), *files("08", "000001")]) == 2


def test_scans_that_mostly_follow_others_are_a_warning():
    several = [*files("00", "000000", "000001", "000002"), *files("08", "000007", "000008")]
    warning = consecutive_warning(several, 18)
    assert (warning.code, warning.scans) == (WarningCode.CONSECUTIVE, ["00", "08"])
    assert "5 scans of 2 sequences form 2 stretches" in warning.message
    assert "18 drives" in warning.hint
    assert consecutive_warning([*several, *files("09", "1", "5", "9")], 18) is None
    assert consecutive_warning(files("00", "000000"), 18) is None


def test_the_code_is_on_the_page_of_warnings():
    assert f"| `{WarningCode.CONSECUTIVE}` |" in PAGE.read_text("utf-8")
