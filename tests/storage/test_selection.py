# SPDX-License-Identifier: MIT
import logging

import pytest
import yaml
from scans import write_sequence

from salsanext_cli.classes import label_space
from salsanext_cli.errors import NoInputError, UsageError
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.storage.selection import (
    ScanSelection,
    data_set_of,
    evenly_spaced,
    select_scans,
    space_of,
)


def names(scans):
    return [f"{scan.sequence}/{scan.stem}" for scan in scans]


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        (ScanSelection(), ["00/000000", "08/000000", "08/000001"]),
        (ScanSelection(split="valid"), ["08/000000", "08/000001"]),
        (ScanSelection(split="train"), ["00/000000"]),
        (ScanSelection(sequences=("8",)), ["08/000000", "08/000001"]),
        (ScanSelection(sequences=("00",), limit=5), ["00/000000"]),
        (ScanSelection(limit=2), ["00/000000", "08/000000"]),
        (ScanSelection(split="valid", limit=1), ["08/000000"]),
    ],
)
def test_choices(world, selection, expected):
    assert names(select_scans(world.data, selection)) == expected


@pytest.mark.parametrize(
    ("selection", "says"),
    [
        ({"split": "test"}, r"no scans of split test \(11, 12.*besides 00, 08"),
        ({"split": "tets"}, "split tets · no such split · expected one of train"),
        ({"sequences": ("08", "77")}, "no scans of sequence 77"),
        ({"limit": 0}, "--limit"),
        ({"split": "valid", "sequences": ("08",)}, "--split and --sequences · both given"),
    ],
)
def test_selections_that_are_none(world, selection, says):
    with pytest.raises((NoInputError, UsageError), match=says):
        select_scans(world.data, ScanSelection(**selection))


def test_a_split_does_not_choose_in_a_folder_of_ones_own(tmp_path, caplog):
    folder = write_sequence(tmp_path / "Straße 9", ["a"])
    with caplog.at_level(logging.WARNING):
        scans = select_scans(folder, ScanSelection(split="valid"))
    assert names(scans) == ["Straße 9/a"]
    assert "no split names Straße 9: taking all" in caplog.text


@pytest.mark.parametrize("name", ["labels.yaml", "semantic-kitti.yaml"])
def test_a_data_set_may_bring_its_own_splits(world, name):
    space = label_space().to_dict() | {"name": "mine", "split": {"odd": ["00"]}}
    (world.data / name).write_text(yaml.safe_dump(space))
    scans = find_scans(world.data)
    assert space_of(scans).splits == {"odd": ("00",)}
    assert names(select_scans(world.data, ScanSelection(split="odd"))) == ["00/000000"]


def test_the_label_space_of_scans_elsewhere_is_the_fallback(tmp_path):
    folder = write_sequence(tmp_path / "one", ["a"])
    (scan,) = find_scans(folder)
    other = label_space()
    assert data_set_of(scan) is None
    assert space_of([scan], other) is other
    assert space_of([]).name == "semantic-kitti"


def test_evenly_spaced_takes_first_and_last_and_none_twice(tmp_path):
    files = find_scans(write_sequence(tmp_path / "08", [f"{i:02d}" for i in range(11)], count=1))
    assert evenly_spaced(files, 0) == files
    assert evenly_spaced(files, 20) == files
    assert [file.stem for file in evenly_spaced(files, 3)] == ["00", "05", "10"]
    assert len(set(evenly_spaced(files, 10))) == 10
