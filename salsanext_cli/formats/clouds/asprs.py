# SPDX-License-Identifier: MIT
"""Classes of the ASPRS, which LAS files hold, for the classes of label spaces."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import MOVING, LabelSpace, RawIds

UNASSIGNED = 1
CLASS_OF_NAME = {
    "unlabeled": UNASSIGNED,
    "unlabelled": UNASSIGNED,
    "outlier": 7,  # noise
    "ground": 2,
    "sidewalk": 2,
    "other-ground": 2,
    "terrain": 2,
    "vegetation": 5,  # high vegetation
    "trunk": 5,
    "building": 6,
    "road": 11,  # road surface
    "parking": 11,
    "lane-marking": 11,
}
"""Classes that the ASPRS has, by name of the label."""
LAST_STANDARD_CLASS = 22
"""Last class that the ASPRS defines."""
FIRST_OWN_CLASS = 64
"""First class that the ASPRS leaves to the user: a raw id without another has this plus the id."""
LAST_OWN_CLASS = 255


def asprs_class(raw_id: int, space: LabelSpace) -> int:
    """Return the class of a raw id; `UNASSIGNED` if it is unknown, or too large for a class."""
    name = space.labels.get(raw_id, "unlabelled")
    if name in CLASS_OF_NAME:
        return CLASS_OF_NAME[name]
    still = (i for i, other in space.labels.items() if MOVING + other == name)
    own = FIRST_OWN_CLASS + next(still, raw_id)
    return own if own <= LAST_OWN_CLASS else UNASSIGNED


def classification(raw: RawIds, space: LabelSpace) -> npt.NDArray[np.uint8]:
    """Return the class of each point, (N,) uint8, for raw ids (N,) without instances."""
    ids, index = np.unique(raw, return_inverse=True)
    classes = [asprs_class(int(raw_id), space) for raw_id in ids]
    of_points: npt.NDArray[np.uint8] = np.array(classes, np.uint8)[index]
    return of_points
