# SPDX-License-Identifier: MIT
"""Differences of recorded settings, by the names of arguments."""

import pytest

from salsanext_cli import label_space
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.wording import Spelling, spelled
from salsanext_cli.runs.results.setting_differences import differences


@pytest.mark.parametrize(
    ("before", "after", "argument"),
    [
        ({"sensor": {"ego_box": []}}, {"sensor": {"ego_box": [-2, -1, -2, 1, 1, 0]}}, "ego"),
        ({"sensor": {"width": 512}}, {"sensor": {"width": 1024}}, "width"),
        ({"precision": "float32"}, {"precision": "bfloat16"}, "precision"),
        ({"knn": {"k": 5}}, {"knn": {"k": 7}}, "knn.k"),
    ],
)
def test_a_difference_names_what_sets_it(before, after, argument):
    for spelling in (Spelling(), CommandLine()):
        with spelled(spelling):
            text = differences(before, after)
        assert text.endswith(f" ({spelling.name(argument)})")
        assert "sensor." not in text
    assert differences(before, before) == ""


def test_an_option_comes_before_what_follows_from_it():
    """`reject` removes the line of the estimated accuracy, whose keys come before it."""
    accuracy = {"slope": 1.1, "offset": 0.2, "deviation": 0.03}
    before = {"accuracy": accuracy, "temperature": 1.4, "weights_version": 5}
    after = {"reject": 0.1, "temperature": 1.4, "weights_version": 5}
    assert differences(before, after) == "reject was not set and is 0.1 (reject)"
    assert differences(after, before) == "reject was 0.1 and is not set (reject)"
    text = differences(before, after | {"seed": 1, "colours": ["error"], "weights_version": 6})
    names = [part.split()[0] for part in text.split(", ")]
    assert names[:2] == ["reject", "seed"]
    assert "colours" in names[2]


def test_a_difference_is_never_empty():
    """Settings without an option still differ, although they follow from something else."""
    assert "temperature" in differences({"temperature": 1.4}, {"temperature": 1.5})
    assert "accuracy.slope" in differences({"accuracy": {"slope": 1.0}}, {})


def test_a_box_is_written_as_it_is_typed():
    box = {"sensor": {"ego_box": [-2.0, -1.0, -2.0, 1.0, 1.0, 0.0]}}
    assert "no box and is -2,-1,-2,1,1,0" in differences({"sensor": {"ego_box": []}}, box)


def test_numbers_of_objects_are_a_further_result_of_predict():
    before, after = {"objects": None}, {"objects": True}
    assert differences(before, after).endswith('(extras=("objects",))')
    with spelled(CommandLine()):
        assert differences(before, after) == "objects was not set and is true (--objects)"


def test_other_classes_are_named_by_their_label_spaces():
    fine, coarse = (
        {"label_space": label_space(name).to_dict()} for name in ("semantic-kitti", "coarse")
    )
    text = differences(fine, coarse)
    assert text == "the classes were semantic-kitti and are coarse (classes)"


def test_cpus_that_compute_int8_in_other_ways_are_told_apart():
    before = {"precision": "int8 with bfloat16 and tiles of bytes"}
    assert differences(before, {"precision": "int8"}) == (
        "int8 was computed with bfloat16 and tiles of bytes, and this CPU has float32 and no tiles "
        "of bytes"
    )
    assert differences(before, {"precision": "float32"}).startswith("precision was ")
    assert differences(before, before) == ""
