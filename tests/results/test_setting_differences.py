# SPDX-License-Identifier: MIT
"""Differences of recorded settings, by the names of options."""

import pytest

from salsanext_cli import label_space
from salsanext_cli.results.setting_differences import differences


@pytest.mark.parametrize(
    ("before", "after", "option"),
    [
        ({"sensor": {"ego_box": []}}, {"sensor": {"ego_box": [-2, -1, -2, 1, 1, 0]}}, "--ego"),
        ({"sensor": {"width": 512}}, {"sensor": {"width": 1024}}, "--width"),
        ({"precision": "float32"}, {"precision": "bfloat16"}, "--precision"),
        ({"knn": {"k": 5}}, {"knn": {"k": 7}}, "--knn-k"),
    ],
)
def test_a_difference_names_the_option_that_sets_it(before, after, option):
    text = differences(before, after)
    assert text.endswith(f" ({option})")
    assert "sensor." not in text
    assert differences(before, before) == ""


def test_a_box_is_written_as_it_is_typed():
    box = {"sensor": {"ego_box": [-2.0, -1.0, -2.0, 1.0, 1.0, 0.0]}}
    assert "no box and is -2,-1,-2,1,1,0" in differences({"sensor": {"ego_box": []}}, box)


def test_other_classes_are_named_by_their_label_spaces():
    fine, coarse = (
        {"label_space": label_space(name).to_dict()} for name in ("semantic-kitti", "coarse")
    )
    text = differences(fine, coarse)
    assert text == "the classes were semantic-kitti and are coarse (--classes)"
