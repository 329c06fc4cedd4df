# SPDX-License-Identifier: MIT
"""Scans that options choose."""

import logging

import pytest
import yaml
from scans import refused, write_sequence

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import (
    choose,
    data_set_of,
    evenly_spaced,
    select_scans,
    space_of,
    with_splits,
)


def names(scans):
    return [f"{scan.sequence}/{scan.stem}" for scan in scans]


def test_choices(world):
    for selection, expected in (
        (ScanSelection(), ["00/000000", "08/000000", "08/000001"]),
        (ScanSelection(split="train"), ["00/000000"]),
        (ScanSelection(sequences=("8",), limit=5), ["08/000000", "08/000001"]),
        (ScanSelection(split="valid", limit=1), ["08/000000"]),
    ):
        assert names(select_scans(world.data, selection)) == expected


def test_a_split_does_not_restrict_a_plain_folder(tmp_path, caplog):
    folder = write_sequence(tmp_path / "Straße 9", ["a"])
    with caplog.at_level(logging.WARNING):
        scans = select_scans(folder, ScanSelection(split="valid"))
    assert names(scans) == ["Straße 9/a"]
    (warning,) = caplog.messages
    assert "Straße 9" in warning


@pytest.mark.parametrize("name", ["labels.yaml", "semantic-kitti.yaml"])
def test_a_data_set_may_describe_its_splits(world, name):
    space = label_space().to_dict() | {"name": "mine", "split": {"odd": ["00"]}}
    (world.data / name).write_text(yaml.safe_dump(space))
    scans = find_scans(world.data)
    assert space_of(scans).splits == {"odd": ("00",)}
    assert names(select_scans(world.data, ScanSelection(split="odd"))) == ["00/000000"]


SPLITS, SAME_IDS = {"odd": ["00"], "valid": ["00", "08"]}, label_space("coarse").to_dict()


@pytest.mark.parametrize("described", [None, {}, SPLITS])
@pytest.mark.parametrize("given", [{}, {"valid": ["00"]}])
def test_given_splits_precede_those_of_the_data_set_and_semantic_kitti(world, described, given):
    if described is not None:
        text = yaml.safe_dump(label_space().to_dict() | {"split": described})
        (world.data / "labels.yaml").write_text(text)
    space = LabelSpace.from_dict(SAME_IDS | {"split": given})
    for alternatives in (False, True):
        complete = with_splits(space, world.data, alternatives=alternatives)
        usual = ("00", "08") if described else ("08",)
        assert complete.splits["valid"] == (("00",) if given else usual)
        assert complete.fits(space)
    chosen = choose(find_scans(world.data), ScanSelection(split="valid"), space, world.data)
    assert {scan.sequence for scan in chosen} == {*complete.splits["valid"]}


def test_a_broken_label_space_is_read_only_where_it_is_needed(world, caplog):
    (world.data / "labels.yaml").write_text("labels: 3")
    whole = LabelSpace.from_dict(SAME_IDS | {"split": {"train": ["00"]}})
    assert with_splits(whole, world.data) is whole
    for _ in range(2):
        assert with_splits(whole, world.data, alternatives=True) is whole
    (warning,) = caplog.messages
    assert str(world.data / "labels.yaml") in warning
    for alternatives in (False, True):
        with refused(UsageError, world.data / "labels.yaml"):
            with_splits(label_space("coarse"), world.data, alternatives=alternatives)


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
