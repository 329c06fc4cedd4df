# SPDX-License-Identifier: MIT
"""Classes that are merged into coarser ones."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging, contradiction
from salsanext_cli.core.errors import UsageError
from salsanext_cli.io.label_spaces import label_space


def test_merged_probabilities_of_a_confident_network_are_at_most_1():
    logits = 12 * np.random.default_rng(0).normal(size=(20, 32768)).astype(np.float32)
    softmax = torch.softmax(torch.from_numpy(logits), dim=0).numpy()
    space, coarse = label_space(), label_space("coarse")
    merged = ClassMerging.between(space, coarse).add(softmax)
    exact = np.zeros(merged.shape)
    for raw, train_id in space.learning_map.items():
        if space.learning_map_inv[train_id] == raw:
            exact[coarse.learning_map[raw]] += softmax[train_id]
    np.testing.assert_allclose(merged, exact, rtol=1e-5, atol=1e-7)
    assert merged.max() <= 1


FULL, COARSE = label_space(), label_space("coarse")
MERGED = {
    "unlabeled": "unlabeled",
    "vehicle": "car truck other-vehicle",
    "person-or-cycle": "bicycle motorcycle person bicyclist motorcyclist",
    "ground": "road parking sidewalk other-ground terrain",
    "structure": "building fence",
    "vegetation": "vegetation",
    "trunk": "trunk",
    "pole-or-sign": "pole traffic-sign",
}


def space_of(targets, count=None, **changes):
    """Return SemanticKITTI's label space with its train ids mapped to others."""
    train = {raw: targets[i] for raw, i in FULL.learning_map.items()}
    count = count or max(targets) + 1
    first = {k: next((r for r, t in train.items() if t == k), 0) for k in range(count)}
    made = {"name": "made", "labels": FULL.labels, "learning_map": train}
    return LabelSpace.from_dict({**made, "learning_map_inv": first, **changes})


def test_coarse_has_seven_classes_of_all_raw_ids_of_semantic_kitti():
    assert COARSE.names == tuple(MERGED)
    assert COARSE.ignored == (True, *[False] * 7)
    assert COARSE.learning_map.keys() == FULL.learning_map.keys()
    assert COARSE.splits == {}
    assert list(COARSE.learning_map_inv.values()) == [0, 10, 30, 40, 50, 70, 71, 80]
    raw = COARSE.to_raw(np.arange(8))
    assert COARSE.to_train(raw).tolist() == list(range(8))
    # The colours are those of the benchmark's class of that raw id.
    np.testing.assert_array_equal(COARSE.colours, FULL.colours[FULL.to_train(raw)])
    # Moving classes, and raw ids without a class in the benchmark.
    assert COARSE.to_train(np.uint32([252, 254, 259, 13, 16, 52, 60, 1, 99])).tolist() == [
        *(1, 2, 1, 1, 1, 4, 3, 0, 0)
    ]


def test_raw_ids_determine_the_merged_classes_and_splits():
    merging = ClassMerging.between(FULL, COARSE)
    groups = [" ".join(FULL.names[i] for i in group) for group in merging.groups]
    assert dict(zip(COARSE.names, groups, strict=True)) == MERGED
    assert merging.space.fits(COARSE)
    targets = [0, *[1] * 8, *[2] * 11]
    assert ClassMerging.between(FULL, space_of(targets)).space.splits == FULL.splits
    merging = ClassMerging.between(FULL, space_of(targets, split={"valid": [3]}))
    assert merging.space.splits == {"valid": ("03",)}


@given(st.lists(st.integers(0, 6), min_size=19, max_size=19), st.integers(0, 2**32 - 1))
def test_sums_are_those_of_a_slow_loop(targets, seed):
    targets = [0, *targets]
    merged = space_of(targets, 7)
    if len({*targets[1:]} - {0}) < 2:
        assert "all 20 classes" in contradiction(FULL, merged)
        return
    merging = ClassMerging.between(FULL, merged)
    assert list(merging.targets) == targets
    softmax = np.random.default_rng(seed).dirichlet(np.ones(20), (3, 4)).astype(np.float32)
    found = merging.add(np.moveaxis(softmax, -1, 0))
    assert (found.shape, found.dtype) == ((7, 3, 4), np.float32)
    for row in range(3):
        for column in range(4):
            for k in range(7):
                pixel = [softmax[row, column, i] for i in range(20) if targets[i] == k]
                assert found[k, row, column] == pytest.approx(sum(pixel), abs=1e-6)
    np.testing.assert_allclose(found.sum(axis=0), 1, atol=1e-6)


ONE_CLASS = {
    "name": "one",
    "labels": {0: "unlabeled", 10: "car", 252: "moving-car"},
    "learning_map": {0: 0, 10: 1},
    "learning_map_inv": {0: 0, 1: 10},
}
NO_MERGING = [
    ONE_CLASS,
    # Labels lack the raw id of a class.
    ONE_CLASS | {"learning_map": {0: 0, 252: 1}},
    FULL.to_dict() | {"learning_ignore": {i: i != 1 for i in range(20)}},
]


@pytest.mark.parametrize("data", NO_MERGING)
def test_classes_that_cannot_be_merged_are_not_merged_into_themselves(data):
    space = LabelSpace.from_dict(data)
    assert ClassMerging.needed(space, LabelSpace.from_dict(space.to_dict())) is None


@given(
    st.lists(st.integers(0, 3), min_size=18, max_size=18),
    st.dictionaries(
        st.sampled_from(sorted(FULL.learning_map)),
        st.lists(st.integers(0, 19), max_size=3),
        max_size=5,
    ),
)
def test_alternatives_are_those_of_the_merged_classes(targets, others):
    several = {raw: sorted({FULL.learning_map[raw], *more}) for raw, more in others.items()}
    own = LabelSpace.from_dict(FULL.to_dict() | {"learning_alternatives": several})
    targets = [0, 1, *targets[:-1], 2]
    merging = ClassMerging.between(own, space_of(targets, 4))
    expected = {}
    for raw, of_raw in several.items():
        classes = sorted({targets[i] for i in of_raw})
        if len(classes) > 1:
            expected[raw] = tuple(classes)
    assert merging.space.alternatives == expected
    stated = {70: [targets[FULL.learning_map[70]]]}
    merged = space_of(targets, 4, learning_alternatives=stated)
    assert ClassMerging.between(own, merged).space.alternatives[70] == tuple(stated[70])


TWO = [0, *[1] * 8, *[2] * 11]


def test_spaces_that_do_not_merge_classes_are_refused():
    for merged, problem in (
        (space_of([0, *[1] * 19]), "20 classes into car"),
        (space_of([0] * 20), "20 classes into unlabeled"),
        (space_of(TWO, learning_ignore={0: True, 2: True}), "into car, road"),
        (
            space_of(TWO, learning_map=space_of(TWO).learning_map | {252: 2}),
            "car into car and road",
        ),
        (
            space_of(TWO, learning_map={0: 0, 10: 1, 40: 2}),
            r"1 \(outlier\), 11 \(bicycle\), 13 \(bus\) and 28 more",
        ),
        (
            space_of(TWO, labels={i: f"thing {i}" for i in FULL.labels}),
            r"thing 13 for raw id 13 \(bus\)",
        ),
    ):
        for merge in (ClassMerging.between, ClassMerging.needed):
            with pytest.raises(UsageError, match=problem) as caught:
                merge(FULL, merged)
            assert caught.value.subject == "label space made"
