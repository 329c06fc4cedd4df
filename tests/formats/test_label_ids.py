# SPDX-License-Identifier: MIT
"""Meaning of the ids of labelling tools."""

from dataclasses import replace

import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.errors import UsageError
from salsanext_cli.formats.label_scalars import NO_VALUE, LabelIds

SPACE = label_space()


def mapped(tmp_path, text):
    (tmp_path / "ids.yaml").write_text(text, "utf-8")
    return LabelIds.of_space(SPACE, tmp_path / "ids.yaml")


def test_raw_ids_mean_themselves_and_keep_their_instances():
    ids = np.array([0, 10, 259, (77 << 16) | 40, 0xFFFF000A, NO_VALUE])
    meanings = LabelIds.of_space(SPACE)
    assert meanings.unknown(ids) == {}
    raw = meanings.to_raw(ids)
    assert raw.dtype == np.uint32
    assert raw.tolist() == [0, 10, 259, (77 << 16) | 40, 0xFFFF000A, 0]


def test_unknown_ids_are_counted_without_instances():
    ids = np.array([7, (1 << 16) | 7, -1, -1, 10, NO_VALUE])
    assert LabelIds.of_space(SPACE).unknown(ids) == {7: 2, -1: 2}


def test_a_tools_own_ids_are_mapped_by_name_or_raw_id(tmp_path):
    meanings = mapped(tmp_path, "-1: unlabeled\n0: road\n1: 10\n2: moving-car\n")
    ids = np.array([-1, 0, 1, (3 << 16) | 2, NO_VALUE])
    assert meanings.to_raw(ids).tolist() == [0, 40, 10, (3 << 16) | 252, 0]
    assert meanings.unknown(np.array([10, 40])) == {10: 1, 40: 1}
    assert meanings.described() == "-1 unlabeled, 0 road, 1 car, 2 moving-car"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("1: tree", "unknown 1: 'tree' · expected whole numbers for 0 unlabeled, 1 outlier"),
        ("car: 1", "unknown 'car': 1"),
        ("1: 7", "unknown 1: 7"),
        ("true: car", "unknown True: 'car'"),
        ("1: 1.0", "unknown 1: 1.0"),
        ("1: [car]", "unknown 1:"),
        ("- car", "a list"),
        ("", "a NoneType"),
        ("1: *a", "reference"),
    ],
)
def test_a_map_that_cannot_be_used_is_one_error(tmp_path, text, found):
    with pytest.raises(UsageError) as caught:
        mapped(tmp_path, text)
    assert found in str(caught.value)


def test_a_class_must_be_left_for_points_without_a_label():
    everything = replace(SPACE, ignored=(False,) * SPACE.class_count)
    with pytest.raises(UsageError, match="class 0, unlabeled, counts"):
        LabelIds.of_space(everything)
