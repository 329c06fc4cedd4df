# SPDX-License-Identifier: MIT
"""Codes of the ASPRS, which LAS files contain, and the classes of a label space."""

from collections.abc import Mapping

from salsanext_cli.core.classes.label_space import BUILT_IN, MOVING, LabelSpace, built_in

STANDARD_NAMES: Mapping[int, str] = {
    0: "Never Classified",
    1: "Unassigned",
    2: "Ground",
    3: "Low Vegetation",
    4: "Medium Vegetation",
    5: "High Vegetation",
    6: "Building",
    7: "Low Point Noise",
    9: "Water",
    10: "Rail",
    11: "Road Surface",
    13: "Wire Guard",
    14: "Wire Conductor",
    15: "Transmission Tower",
    16: "Wire Connector",
    17: "Bridge Deck",
    18: "High Noise",
    19: "Overhead Structure",
    20: "Ignored Ground",
    21: "Snow",
    22: "Temporal Exclusion",
}
"""Names of the codes that the ASPRS defines, in letters and blanks."""
UNASSIGNED_CODES = (0, 1, 7, 18)  # Never classified, unassigned, and noise
LOWER_VEGETATION = (3, 4)  # Low and medium vegetation
HIGH_VEGETATION = 5


def train_ids_of_codes(space: LabelSpace) -> dict[int, set[int]]:
    """Return the train ids of the classes of a label space by their codes.

    The set of a code is empty if its raw ids are of no class, that is of train id 0. A label space
    with a model also has the codes of SemanticKITTI that it does not use itself, so that a building
    of a survey is of the coarse class that contains buildings.
    """
    train_ids = _train_ids(space, space.asprs_codes)
    if space.model() is None:
        return train_ids
    return _train_ids(space, built_in(BUILT_IN[0]).asprs_codes) | train_ids


def _train_ids(space: LabelSpace, codes: Mapping[int, int]) -> dict[int, set[int]]:
    """Return the train ids, without 0, of the raw ids of each code."""
    train_ids: dict[int, set[int]] = {code: set() for code in codes.values()}
    for raw, code in codes.items():
        train_ids[code].add(space.learning_map.get(raw, 0))
    return {code: ids - {0} for code, ids in train_ids.items()}


def names_of_codes(space: LabelSpace) -> dict[int, str]:
    """Return the names of the codes of a label space.

    The name is that of the raw ids or the class if only one has the code, else that of the ASPRS.
    Codes for users that several classes have are without a name.
    """
    names: dict[int, set[str]] = {code: set() for code in space.asprs_codes.values()}
    for raw, code in space.asprs_codes.items():
        names[code].add(space.labels.get(raw, "").removeprefix(MOVING))
    train_ids = _train_ids(space, space.asprs_codes)
    return {code: _name(space, code, names[code], train_ids[code]) for code in names}


def _name(space: LabelSpace, code: int, names: set[str], train_ids: set[int]) -> str:
    """Return the name of a code by the names of its raw ids, or by their train ids."""
    if len(names) == 1:
        return min(names)
    if len(train_ids) == 1:
        return space.names[min(train_ids)]
    return STANDARD_NAMES.get(code, "")


def classes_without_code(space: LabelSpace) -> list[str]:
    """Return the names of the classes, without class 0, whose labels have no code."""
    raw_ids = [space.learning_map_inv[train_id] for train_id in range(1, space.class_count)]
    return [space.labels[raw] for raw in raw_ids if raw not in space.asprs_codes]
