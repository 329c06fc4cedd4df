# SPDX-License-Identifier: MIT
"""Options of commands for the fields of records that stages take as arguments."""

from dataclasses import Field
from functools import partial
from typing import Any, Literal

from salsanext_cli.commands.line.options.option_fields import (
    Declaration,
    declaration_in,
    names_in,
    option_declaration,
)
from salsanext_cli.commands.line.values.events_option import typed_events
from salsanext_cli.commands.line.values.shard_option import typed_shard
from salsanext_cli.core.engines.registry import LIBRARIES, engine_names
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery, named_label_space
from salsanext_cli.runs.scans.scan_selection import ScanSelection

TITLES = " and ".join(library.title for library in LIBRARIES.values())
"""Libraries that compute, the fastest first."""

selection = partial(option_declaration, panel="Selection")
network = partial(option_declaration, panel="Network")
running = partial(option_declaration, panel="Running")

OPTIONS: dict[type, dict[str, Declaration]] = {
    ScanSelection: {
        "split": selection("Only the sequences of this split.", metavar="train|valid|test"),
        "sequences": selection(
            "Only these sequences, such as 00,08.",
            parse=partial(names_in, option="--sequences", example="00,08"),
            metavar="NAMES",
        ),
        "limit": selection("Only the first N scans."),
    },
    ResultQuery: {
        "dataset": selection(
            "Data set with the scans and labels, for results that do not record it, or whose scans "
            "were moved; also SALSANEXT_DATASET.",
            show_default="the recorded data set; without a record, the current folder",
        ),
        "label_space": selection(
            "Label space of the labels: built-in, or a .yaml file in SemanticKITTI's format.",
            metavar="NAME|FILE",
            show_default="label space of the data set, else semantic-kitti",
            parse=named_label_space,
        ),
        "classes": selection(
            "Merge classes: `coarse`, or a label-space file.",
            metavar="coarse|FILE",
            parse=named_label_space,
        ),
    },
    NetworkSettings: {
        "weights": network(
            "Weights file (.safetensors).", show_default="the weights of the package"
        ),
        "device": network("Device; auto: a GPU if there is one.", metavar="cpu|cuda|cuda:N"),
        "precision": network(
            "Precision; auto chooses a fast float for the device; int8 is faster on a CPU, and "
            "changes about 1 % of the labels.",
            envvar="SALSANEXT_PRECISION",
            typed=Literal["auto", "float32", "bfloat16", "float16", "int8"],
        ),
        "engine": network(
            f"Library that computes; auto uses the first of {TITLES} that runs on the device.",
            envvar="SALSANEXT_ENGINE",
            typed=Literal[engine_names()],
        ),
        "sensor": network(
            "Sensor of the scans; auto estimates field of view and mounting. A named sensor sets "
            "only intensity scale and noise.",
            typed=str,
            metavar="auto|NAME|FILE",
        ),
        "columns": network(
            "Columns of files without a header, such as x,y,z,intensity,_; _ skips a column.",
            metavar="NAMES",
            show_default="columns of the sensor",
        ),
        "intensity_field": network(
            "Field with the intensity.", metavar="NAME", show_default="the usual names"
        ),
        "width": network(
            "Columns of the range image; more take longer and show small objects better.",
            metavar="512|1024|2048",
            show_default="of the weights",
        ),
        "min_range": network(
            "Leave points nearer than this unlabelled, in metres.",
            show_default="1, or 0.8 of the height of a lower sensor",
        ),
        "ego": network(
            "Bounding box of your own vehicle, whose points stay unlabelled: x,y,z min, then max, "
            "in metres; auto estimates it from the scans of a drive.",
            metavar="auto|none|BOX",
        ),
        "intensity": network(
            "Match the intensity to that of the training scans, use it raw, or ignore it; auto "
            "matches it if the weights contain the intensity of their training scans.",
            typed=Literal["auto", "match", "raw", "none"],
        ),
    },
    KnnParameters: {
        "k": network("Number of neighbours that vote.", "--knn-k"),
        "window": network("Side of the window of neighbours, in pixels.", "--knn-window"),
        "sigma": network("Standard deviation of the Gaussian weights, in pixels.", "--knn-sigma"),
        "cutoff": network(
            "Maximum difference in range between a point and a neighbour, in metres.",
            "--knn-cutoff",
        ),
    },
    FusionReach: {
        "reach": option_declaration("Number of scans before and after a scan that vote."),
        "movable_reach": option_declaration(
            "The same for vehicles, people and riders that may have moved."
        ),
    },
    RunOptions: {
        "jobs": running("Number of worker processes; -1: one per core.", "--jobs", "-j"),
        "cluster": running(
            "Ray cluster whose workers take the place of --jobs.",
            envvar="SALSANEXT_CLUSTER",
            metavar="auto|HOST:PORT|ray://HOST:PORT",
        ),
        "shard": running(
            "Work on share I of N of the scans.",
            parse=typed_shard,
            metavar="I/N",
            show_default="the share of this task of a Slurm array or Kubernetes job, else 1/1",
        ),
        "overwrite": running("Replace existing results."),
        "on_error": running("Skip a scan that fails, or stop."),
        "events": running(
            "Append a line of JSON for each scan as it ends.", parse=typed_events, metavar="FILE"
        ),
    },
}
"""Declaration of each field that commands offer, by record."""


def declaration_of(record: type, field: Field[Any]) -> Declaration | None:
    """Return how commands offer a field of a record; None if they do not."""
    declared = OPTIONS.get(record, {}).get(field.name)
    # Records of the command line declare their fields themselves.
    return declared or declaration_in(field)
