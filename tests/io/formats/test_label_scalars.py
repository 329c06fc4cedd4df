# SPDX-License-Identifier: MIT
"""Label scalars of clouds of other programs, and the meaning of their ids."""

from dataclasses import replace

import numpy as np
import pytest
from edited_clouds import WRITERS

from salsanext_cli import label_space
from salsanext_cli.core.errors import FormatError, LabelError, UsageError
from salsanext_cli.io.formats.label_scalars import NO_VALUE, LabelIds, LabelledCloud, whole_numbers

POINTS = np.random.default_rng(0).uniform(-30, 30, (40, 3)).round(3)  # LAS has millimetres.
IDS = np.arange(40) % 3 * 40


def write(name, path, scalars):
    return WRITERS[name](path, POINTS, scalars)


def write_ply(path, scalars):
    return write("s.ply", path, scalars)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("scalar", ["label", "scalar_Label", "Sem_Class"])
@pytest.mark.parametrize("kind", ["f4", "f8", "u2", "i4"])
def test_labels_and_coordinates_are_read(tmp_path, name, scalar, kind):
    scalars = {"other": np.ones(len(POINTS), "f4"), scalar: IDS.astype(kind)}
    found = LabelledCloud.read(write(name, tmp_path / name, scalars))
    np.testing.assert_array_equal(found.ids, IDS)
    assert found.scalar == scalar
    np.testing.assert_array_equal(found.points, POINTS.astype("f4"))


def test_the_scalar_is_named_if_there_is_none_or_several(tmp_path):
    scalars = {"mine": IDS.astype("f4"), "scalar_mine": IDS.astype("f4") + 1}
    path = write_ply(tmp_path / "s.ply", scalars)
    with pytest.raises(FormatError, match="x, y, z, mine"):
        LabelledCloud.read(path)
    for name, more in (("mine", 0), ("scalar_mine", 1)):
        np.testing.assert_array_equal(LabelledCloud.read(path, name).ids, IDS + more)
    for name in ("Mine", "his"):
        with pytest.raises(FormatError, match=f"expected one named {name}"):
            LabelledCloud.read(path, name)
    path = write_ply(tmp_path / "s.ply", {"label": IDS.astype("f4"), "CLASS": IDS.astype("f4")})
    with pytest.raises(LabelError, match="label, CLASS"):
        LabelledCloud.read(path)
    np.testing.assert_array_equal(LabelledCloud.read(path, "class").ids, IDS)


def test_a_classification_of_0_is_not_a_label_and_one_of_the_asprs_must_be_named(tmp_path):
    """As in clouds that PDAL or CloudCompare converted from LAS."""
    labels, path = {"label": IDS.astype("u2")}, tmp_path / "s.ply"
    unused = labels | {"classification": np.zeros(len(IDS), "u1")}
    assert LabelledCloud.read(write_ply(path, unused)).scalar == "label"
    with pytest.raises(LabelError, match="several"):
        LabelledCloud.read(write_ply(path, labels | {"classification": IDS.astype("u1")}))
    for name in ("classification", "scalar_Classification"):
        write_ply(path, {name: IDS.astype("f4")})
        np.testing.assert_array_equal(LabelledCloud.read(path).ids, IDS)
        write_ply(path, {name: (IDS // 8).astype("f4")})
        with pytest.raises(LabelError, match="up to 10"):
            LabelledCloud.read(path)
        np.testing.assert_array_equal(LabelledCloud.read(path, name).ids, IDS // 8)


def test_labels_that_are_not_whole_numbers_are_errors(tmp_path):
    for values, message in (
        (np.float32([1, 2.5, 0.5]), "label 2.5 at point 1, and 1 more"),
        (np.float64([np.nan, np.inf]), "label inf at point 1"),
        (np.float32([0, 1 << 25]), "up to 16777216, since 32-bit floats"),
        (np.float64([1 << 33]), "up to 4294967295"),
        (np.uint64([1 << 63]), "up to 4294967295"),
        (np.int64([-(1 << 63)]), "up to 4294967295"),
    ):
        with pytest.raises(LabelError, match=message):
            whole_numbers(values, tmp_path, "label")


@pytest.mark.parametrize("kind", ["f2", "f4", "f8", "i1", "u1", "i8", "u8"])
def test_whole_numbers_stay_what_they_are(tmp_path, kind):
    values = np.arange(100).astype(kind)
    np.testing.assert_array_equal(whole_numbers(values, tmp_path, "label"), np.arange(100))
    if kind[0] == "f":
        values[3] = np.nan
        assert whole_numbers(values, tmp_path, "label")[3] == NO_VALUE
        values[3] = -1
        assert whole_numbers(values, tmp_path, "label")[3] == -1


SPACE = label_space()


def mapped(tmp_path, text):
    (tmp_path / "ids.yaml").write_text(text, "utf-8")
    return LabelIds.from_space(SPACE, tmp_path / "ids.yaml")


def test_raw_ids_mean_themselves_and_keep_their_instances():
    ids = np.array([0, 10, 259, (77 << 16) | 40, 0xFFFF000A, NO_VALUE])
    meanings = LabelIds.from_space(SPACE)
    assert meanings.unknown(ids) == {}
    raw = meanings.to_raw(ids)
    assert raw.dtype == np.uint32
    assert raw.tolist() == [0, 10, 259, (77 << 16) | 40, 0xFFFF000A, 0]
    ids = np.array([7, (1 << 16) | 7, -1, -1, 10, NO_VALUE])
    assert meanings.unknown(ids) == {7: 2, -1: 2}


def test_ids_of_a_tool_are_mapped_by_name_or_raw_id(tmp_path):
    meanings = mapped(tmp_path, "-1: unlabeled\n0: road\n1: 10\n2: moving-car\n")
    ids = np.array([-1, 0, 1, (3 << 16) | 2, NO_VALUE])
    assert meanings.to_raw(ids).tolist() == [0, 40, 10, (3 << 16) | 252, 0]
    assert meanings.unknown(np.array([10, 40])) == {10: 1, 40: 1}
    assert meanings.described() == "-1 unlabeled, 0 road, 1 car, 2 moving-car"


def test_a_map_that_cannot_be_used_is_one_error_and_class_0_must_be_ignored(tmp_path):
    for text, problem in (
        ("1: tree", "1: 'tree'"),
        ("car: 1", "'car': 1"),
        ("true: car", "True: 'car'"),
        ("1: 1.0", "1: 1.0"),
        ("- car", "a list"),
        ("1: *a", "reference"),
    ):
        with pytest.raises(UsageError) as caught:
            mapped(tmp_path, text)
        assert problem in caught.value.problem
    everything = replace(SPACE, ignored=(False,) * SPACE.class_count)
    with pytest.raises(UsageError, match="class 0"):
        LabelIds.from_space(everything)
