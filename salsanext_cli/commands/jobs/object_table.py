# SPDX-License-Identifier: MIT
"""Table of the objects of a scan."""

import csv
import io

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.objects import BOX, Objects, fit_boxes
from salsanext_cli.core.labelling import LabelledScan


def object_table(scan: LabelledScan, objects: Objects, space: LabelSpace) -> bytes:
    """Return a table of class, number of points and box of each object.

    Parameters
    ----------
    scan : LabelledScan
        Scan of N points with their labels.
    objects : ndarray of integer (N,)
        Number of the object of each point, 0 for none.
    space : LabelSpace
        Classes of the labels.

    Returns
    -------
    bytes
        Content of a .csv file.
    """
    sizes = np.bincount(objects)
    class_of_object = np.zeros(len(sizes), np.uint8)
    # All points of an object have its class.
    class_of_object[objects] = scan.labels
    cars = [train_id for train_id, name in enumerate(space.names) if name == "car"]
    is_car = np.isin(class_of_object[1:], cars)
    checked = scan.checked
    boxes = fit_boxes(checked.scan.points, objects, is_car, checked.sensor.origin[:2])
    file = io.StringIO()
    table = csv.writer(file, lineterminator="\n")
    table.writerow(("object", "class", "points", *BOX))
    for number, box in enumerate(boxes, start=1):
        class_name = space.names[class_of_object[number]]
        lengths = [f"{value:.3f}" for value in box]
        table.writerow((number, class_name, sizes[number], *lengths))
    return file.getvalue().encode()
