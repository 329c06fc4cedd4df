# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The table of the objects of a scan."""

import csv
from dataclasses import replace

import numpy as np
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import load_network
from salsanext_cli.commands.jobs.object_table import object_table
from salsanext_cli.core.labellers import label_scan
from salsanext_cli.core.labelling import LabelRequest

COUNTS = {"car": 40, "person": 7}


def test_each_object_has_a_row_with_its_class_and_number_of_points(weights):
    network = load_network(weights, "cpu", SMALL, engine="torch")
    labelled = label_scan(make_scan(), network, LabelRequest())
    objects = np.zeros(len(labelled.labels), np.int64)
    labels = np.zeros(len(labelled.labels), np.uint8)
    start = 0
    for number, (name, count) in enumerate(COUNTS.items(), start=1):
        objects[start : start + count] = number
        labels[start : start + count] = network.space.names.index(name)
        start += count
    table = object_table(replace(labelled, labels=labels), objects, network.space).decode()
    rows = [*csv.DictReader(table.splitlines())]
    assert [int(row["object"]) for row in rows] == [1, 2]
    assert {row["class"]: int(row["points"]) for row in rows} == COUNTS


def test_a_scan_without_objects_has_a_header_alone(weights):
    network = load_network(weights, "cpu", SMALL, engine="torch")
    labelled = label_scan(make_scan(), network, LabelRequest())
    objects = np.zeros(len(labelled.labels), np.int64)
    assert object_table(labelled, objects, network.space).count(b"\n") == 1
