# SPDX-License-Identifier: MIT
"""Label spaces, and the merging of classes."""

import json

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scans import refused

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.errors import LabelError, UsageError
from salsanext_cli.io.label_spaces import label_space

NAMES = (
    "unlabeled car bicycle motorcycle truck other-vehicle person bicyclist motorcyclist road"
    " parking sidewalk other-ground building fence vegetation trunk terrain pole traffic-sign"
)

SMALL = """
labels: {0: nothing, 5: street, 6: lane, 7: wall}
color_map: {0: [0, 0, 0], 5: [255, 0, 10], 7: [1, 2, 3]}
learning_map: {0: 0, 5: 1, 6: 1, 7: 2}
learning_map_inv: {0: 0, 1: 5, 2: 7}
learning_ignore: {0: true, 1: false, 2: true}
split: {train: [0, 1, 10], valid: ["town", 8]}
"""


@pytest.fixture
def small():
    return LabelSpace.from_dict(yaml.safe_load(SMALL), "small")


def changed(**changes):
    return {**yaml.safe_load(SMALL), **changes}


def test_facts_of_semantic_kitti():
    space = label_space()
    assert space.class_count == 20
    assert list(space.names) == NAMES.split()
    assert space.ignored == (True, *[False] * 19)
    assert space.scored.tolist() == [False, *[True] * 19]
    assert space.split("train") == ("00", "01", "02", "03", "04", "05", "06", "07", "09", "10")
    assert space.split("valid") == ("08",)
    assert space.split("test") == tuple(str(n) for n in range(11, 22))
    train = space.to_train(np.uint32([[10, 252, 1, 52], [99, 60, 81, 0]]))
    assert train.tolist() == [[1, 1, 0, 0], [0, 9, 19, 0]]
    raw = space.to_raw(np.uint8([1, 9, 19, 0]))
    assert raw.tolist() == [10, 40, 81, 0]
    assert (train.dtype, raw.dtype) == (np.uint8, np.uint32)
    # Red, green, blue
    assert space.colours[[1, 9, 15]].tolist() == [[100, 150, 245], [255, 0, 255], [0, 175, 0]]


@given(st.sampled_from(sorted(label_space().learning_map)), st.integers(0, 2**16 - 1))
def test_instance_bits_are_dropped_and_shapes_kept(raw, instance):
    space = label_space()
    train = space.to_train(np.full((2, 3), raw + (instance << 16), np.uint32))
    np.testing.assert_array_equal(train, np.full((2, 3), space.learning_map[raw], np.uint8))


def test_unknown_ids_and_train_ids_instead_of_raw_ids_are_errors() -> None:
    raw = np.uint32([10, 7, 7 + (3 << 16), 65535, *[40] * 26, 0])
    space = label_space()
    with pytest.raises(LabelError, match=r"a\.label: .* 7 \(2×\), 65535 \(1×\)"):
        space.to_train(raw, source="a.label")
    assert space.to_train(raw, strict=False).tolist() == [1, 0, 0, 0, *[9] * 26, 0]
    # A few, and up to a tenth of many points, are tolerated.
    assert not space.to_train(raw[1:4], strict=False).any()
    with pytest.raises(LabelError, match=r"7 \(200×\), 65535 \(100×\): 15 % of the labelled po"):
        space.to_train(np.uint32([7] * 200 + [65535] * 100 + [40] * 1700), strict=False)
    assert space.to_train(np.uint32([7] * 300 + [40] * 2500), strict=False).sum() == 9 * 2500
    assert space.unknown_ids(raw) == {7: 2, 65535: 1}
    assert space.unknown_ids(np.uint32([10])) == {}
    train = space.to_train(np.uint32(sorted(space.learning_map)))
    for strict in (True, False):
        with pytest.raises(LabelError, match=r"train ids.* 19"):
            space.to_train(train.astype(np.uint32), strict=strict)


def test_another_label_space(small):
    assert small.name == "small"
    assert small.names == ("nothing", "street", "wall")
    assert small.ignored == (True, False, True)
    assert small.colours.tolist() == [[0, 0, 0], [10, 0, 255], [3, 2, 1]]
    assert small.to_train(np.uint32([6, 7, 0])).tolist() == [1, 2, 0]
    assert small.splits == {"train": ("00", "01", "10"), "valid": ("town", "08")}
    assert small.split_of("town") == "valid"
    assert small.split_of("10") == "train"
    assert small.split_of("11") is None
    with pytest.raises(UsageError, match="one of train, valid"):
        small.split("test")


def test_optional_keys_have_defaults():
    data = yaml.safe_load(SMALL)
    for key in ("color_map", "learning_ignore", "split"):
        del data[key]
    space = LabelSpace.from_dict(data, "bare")
    assert space.ignored == (True, False, False)
    assert space.splits == {}
    assert space.colours[0].tolist() == [0, 0, 0]
    assert len({tuple(colour) for colour in space.colours.tolist()}) == 3


def test_round_trip_through_json_and_yaml(small):
    for space in (small, label_space()):
        for back in (
            LabelSpace.from_dict(json.loads(json.dumps(space.to_dict()))),
            LabelSpace.from_dict(yaml.safe_load(yaml.safe_dump(space.to_dict()))),
        ):
            assert back.to_dict() == space.to_dict()
            assert back.fits(space)
            assert back.splits == space.splits
    other = LabelSpace.from_dict(changed(labels={0: "nothing", 5: "street", 6: "x", 7: "wall"}))
    assert small.fits(other)
    assert not small.fits(label_space())


MALFORMED = {
    "labels": (None, {"a": "b"}, [1, 2]),
    "learning_map": ({0: 0, 5: "x"}, {0: 0, 5: 3}, {0: 0, 70000: 1}, {0: 0, -5: 1}),
    "learning_map_inv": ({}, {0: 0, 2: 7}, dict.fromkeys(range(300), 0), {0: 0, 1: 5, 2: 8}),
    "color_map": ({5: "red"}, {5: [1, 2]}, {5: [1, 2, 256]}),
    "split": ({"valid": 8}, [8]),
    "movable": ([0], [3], [-1], ["wall"], "wall", {1: True}, 1),
}


@pytest.mark.parametrize(("key", "value"), [(k, v) for k, each in MALFORMED.items() for v in each])
def test_malformed_spaces(key, value):
    refused(UsageError, "small", LabelSpace.from_dict, changed(**{key: value}), "small")


def names_of_movable(space):
    return {name for name, moves in zip(space.names, space.movable, strict=True) if moves}


KITTI_MOVABLE = set(NAMES.split()[1:9])
CAR_AND_STREET = {
    "labels": {0: "none", 10: "vehicle", 252: "moving-car", 40: "street", 30: "pedestrian"},
    "learning_map": {0: 0, 10: 1, 252: 1, 40: 2, 30: 3},
    "learning_map_inv": {0: 0, 1: 10, 2: 40, 3: 30},
}


def test_movable_classes_are_stated_or_by_raw_ids_of_semantic_kitti():
    assert names_of_movable(label_space()) == KITTI_MOVABLE
    assert names_of_movable(label_space("coarse")) == {"vehicle", "person-or-cycle"}
    for space in (label_space(), label_space("coarse")):
        # Older weights and records, and the file of the data set, do not state them.
        data = space.to_dict()
        assert "movable" not in data
        assert names_of_movable(LabelSpace.from_dict(data)) == names_of_movable(space)
        data["labels"] = data["labels"] | {15: "Motorrad"}
        renamed = LabelSpace.from_dict(data)
        np.testing.assert_array_equal(renamed.movable, space.movable)
    # Words of names do not count.
    own = LabelSpace.from_dict(CAR_AND_STREET)
    assert names_of_movable(own) == set()
    stated = LabelSpace.from_dict(CAR_AND_STREET | {"movable": [3, 1]})
    assert names_of_movable(stated) == {"vehicle", "pedestrian"}
    of_kitti = LabelSpace.from_dict(label_space().to_dict() | {"movable": []})
    for space, names in ((stated, {"vehicle", "pedestrian"}), (of_kitti, set())):
        back = LabelSpace.from_dict(json.loads(json.dumps(space.to_dict())))
        assert names_of_movable(back) == names
    assert own.differences(stated) == ["movable 1: False ≠ True", "movable 3: False ≠ True"]


def test_options_that_need_movable_classes_have_a_hint(small):
    label_space("coarse").require_movable("--objects")
    with pytest.raises(UsageError) as caught:
        small.require_movable("--objects")
    assert "movable: [1, 2]" in caught.value.hint


def test_a_label_space_of_the_same_classes_states_what_is_movable():
    own = LabelSpace.from_dict(CAR_AND_STREET)
    assert ClassMerging.needed(own, LabelSpace.from_dict(CAR_AND_STREET | {"movable": []})) is None
    stated = LabelSpace.from_dict(CAR_AND_STREET | {"movable": [3]})
    merging = ClassMerging.needed(own, stated)
    assert names_of_movable(merging.space) == {"pedestrian"}
    softmax = np.float32([[0.1], [0.2], [0.3], [0.4]])
    np.testing.assert_array_equal(merging.add(softmax), softmax)


def test_file(tmp_path, small):
    path = tmp_path / "größe 1.yaml"
    path.write_text(SMALL)
    space = label_space(path)
    assert space.name == "größe 1"
    assert space.fits(small)
    assert label_space(str(path)).to_dict() == space.to_dict()


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(UsageError, match="semantic-kitti"):
        label_space("semantic-kiti")
    with pytest.raises(UsageError, match="directory"):
        label_space(tmp_path)
    # It would never end.
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="regular file"):
        label_space(tmp_path / "zero.yaml")


def test_differences_are_named_the_classes_first():
    space = label_space()
    assert space.differences(space) == []
    data = space.to_dict()
    data["labels"] = {**data["labels"], 15: "motorbike"}
    data["learning_map"] = {**data["learning_map"], 13: 0}
    data["learning_ignore"] = {**data["learning_ignore"], 1: True}
    data["split"] = {**data["split"], "valid": [7, 8]}
    other = LabelSpace.from_dict(data | {"name": "mine"})
    assert space.differences(other) == [
        "train id 3: motorcycle ≠ motorbike",
        "name : semantic-kitti ≠ mine",
        "labels 15: motorcycle ≠ motorbike",
        "learning_map 13: 5 ≠ 0",
        "learning_ignore 1: False ≠ True",
        "split valid: ['08'] ≠ ['07', '08']",
    ]
    assert space.differences(LabelSpace.from_dict(yaml.safe_load(SMALL)))[:4:3] == [
        "train id 0: unlabeled ≠ nothing",
        "train id 3: motorcycle ≠ none",
    ]
