# SPDX-License-Identifier: MIT
"""Codes of the ASPRS of label spaces, compared with loops over their classes."""

import json

import pytest

from salsanext_cli.core.classes.asprs import (
    STANDARD_NAMES,
    classes_without_code,
    names_of_codes,
    train_ids_of_codes,
)
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.io.label_spaces import label_space

SPACE = label_space()
COARSE = label_space("coarse")
FOREIGN = {
    "labels": {0: "none", 2: "car", 3: "van", 7: "person", 900: "street"},
    "learning_map": {0: 0, 2: 1, 3: 1, 7: 2, 900: 3},
    "learning_map_inv": {0: 0, 1: 2, 2: 7, 3: 900},
}


def foreign(**changes):
    return LabelSpace.from_dict({**FOREIGN, **changes}, "foreign")


def test_classes_of_another_label_space_have_codes_for_users():
    space = foreign()
    assert space.asprs_codes == {0: 1, 2: 65, 3: 65, 7: 66, 900: 67}
    assert names_of_codes(space) == {1: "none", 65: "car", 66: "person", 67: "street"}
    assert train_ids_of_codes(space) == {1: set(), 65: {1}, 66: {2}, 67: {3}}
    assert classes_without_code(space) == []
    # The default needs no statement.
    assert "asprs" not in space.to_dict()


def test_classes_beyond_the_last_code_have_none():
    ids = range(200)
    space = LabelSpace.from_dict(
        {
            "labels": {i: f"class {i}" for i in ids},
            "learning_map": {i: i for i in ids},
            "learning_map_inv": {i: i for i in ids},
        },
        "wide",
    )
    assert classes_without_code(space) == [f"class {i}" for i in range(192, 200)]
    assert max(space.asprs_codes.values()) == 255


def test_stated_codes_replace_the_default():
    stated = {0: 1, 2: 70, 7: 70, 900: 11}
    space = foreign(asprs=stated)
    assert space.asprs_codes == stated
    assert train_ids_of_codes(space) == {1: set(), 70: {1, 2}, 11: {3}}
    assert names_of_codes(space) == {1: "none", 70: "", 11: "street"}
    back = LabelSpace.from_dict(json.loads(json.dumps(space.to_dict())))
    assert back.asprs_codes == stated
    assert classes_without_code(foreign(asprs={2: 70})) == ["person", "street"]


def test_renamed_classes_of_a_model_have_no_code():
    data = SPACE.to_dict()
    renamed = LabelSpace.from_dict({**data, "labels": {**data["labels"], 10: "Auto"}})
    assert classes_without_code(renamed) == ["Auto"]
    assert renamed.asprs_codes[11] == SPACE.asprs_codes[11]


@pytest.mark.parametrize("space", [SPACE, COARSE])
def test_built_in_classes_have_a_code_with_the_name_of_the_only_one(space):
    assert classes_without_code(space) == []
    names = names_of_codes(space)
    for code in set(space.asprs_codes.values()):
        raw_ids = [raw for raw, other in space.asprs_codes.items() if other == code]
        train_ids = {space.learning_map[raw] for raw in raw_ids}
        if len(train_ids) > 1:
            assert names[code] == STANDARD_NAMES[code]
        else:
            still = {space.labels[raw].removeprefix("moving-") for raw in raw_ids}
            assert names[code] in (still if len(still) == 1 else {space.names[min(train_ids)]})


def test_names_of_codes():
    names = names_of_codes(SPACE)
    assert [names[i] for i in (1, 74, 80, 2, 11, 6)] == [
        "unlabeled",
        "car",
        "on-rails",
        "Ground",
        "Road Surface",
        "building",
    ]


def test_the_classes_of_a_code():
    ids = train_ids_of_codes(SPACE)
    assert {SPACE.names[i] for i in ids[2]} == {"sidewalk", "other-ground", "terrain"}
    assert {SPACE.names[i] for i in ids[11]} == {"road", "parking"}
    assert (ids[1], ids[7]) == (set(), set())
    coarse = train_ids_of_codes(COARSE)
    # Of SemanticKITTI alone, whose building is a structure
    assert 6 not in COARSE.asprs_codes.values()
    assert [COARSE.names[i] for i in coarse[6]] == ["structure"]
    assert [COARSE.names[i] for i in coarse[2]] == ["ground"]
