# SPDX-License-Identifier: MIT
import logging

import pytest
import yaml
from scans import write_sequence

from salsanext_cli.classes import label_space
from salsanext_cli.errors import NoInputError, UsageError
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.storage.selection import ScanSelection, data_set_of, select_scans, space_of


def names(scans):
    return [f"{scan.sequence}/{scan.stem}" for scan in scans]


def test_all_scans_sorted(world):
    assert names(select_scans(world.data, ScanSelection())) == [
        "00/000000",
        "08/000000",
        "08/000001",
    ]


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
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


def test_a_split_without_scans_is_an_error(world):
    with pytest.raises(NoInputError, match=r"no scans of split test \(11, 12.*besides 00, 08"):
        select_scans(world.data, ScanSelection(split="test"))


def test_unknown_splits_and_sequences_are_errors(world):
    with pytest.raises(UsageError, match="split tets · no such split · expected one of train"):
        select_scans(world.data, ScanSelection(split="tets"))
    with pytest.raises(NoInputError, match="no scans of sequence 77"):
        select_scans(world.data, ScanSelection(sequences=("08", "77")))


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


@pytest.mark.parametrize("options", [{"limit": 0}, {"limit": -3}])
def test_limits_that_are_none(options):
    with pytest.raises(UsageError, match="--limit"):
        ScanSelection(**options)


def test_split_and_sequences_exclude_each_other():
    with pytest.raises(UsageError, match="--split and --sequences · both given"):
        ScanSelection(split="valid", sequences=("08",))


def test_an_empty_folder_and_one_that_is_not_there(tmp_path):
    with pytest.raises(NoInputError, match="holds no scans"):
        select_scans(tmp_path, ScanSelection())
    with pytest.raises(NoInputError, match="no such file"):
        select_scans(tmp_path / "none", ScanSelection())
