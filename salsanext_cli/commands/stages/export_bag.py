# SPDX-License-Identifier: MIT
"""Stage `export-bag`: bags with a topic of the clouds and their labels and uncertainties."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.ros.bag_copies import Types
from salsanext_cli.io.formats.ros.bags import Bag
from salsanext_cli.io.formats.ros.cloud_changes import cloud_with_values
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.runs.copies.bag_run import BagOfResults, BagRun, bags_of, label_path
from salsanext_cli.runs.copies.filled_folder import begin
from salsanext_cli.runs.loop.run import Outcome, RunOptions
from salsanext_cli.runs.results.folder_names import PREDICTION_STAGES
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import ScanResults
from salsanext_cli.runs.scans.scan_file import ScanFile

LABELLED = "labelled"  # Last part of the name of the new topic


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportBagSettings:
    """Settings that decide the new clouds; None are not recorded."""

    label_space: LabelSpace
    origins: Mapping[str, str]  # Digests of the settings of earlier stages, by name
    results: str  # Absolute path of the folder of the labels
    topic: str | None = None  # Name of the new topic, if not the usual one


def export_bag(
    out: Path,
    folder: Path,
    *,
    topic: str | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write bags with the labelled clouds to `FOLDER/<seq>.bag` (ROS 1) or `FOLDER/<seq>/` (ROS 2).

    The new clouds are PointCloud2 with the fields of the old ones, `label` (uint32, raw ids),
    `instance` (uint16), all uncertainties (float32) and `rgb` (the colour of the class). All other
    messages stay.

    Parameters
    ----------
    out : Path
        Folder with labels of clouds in bags.
    folder : Path
        Folder for the bags.
    topic : str, optional
        Topic of the new clouds; by default that of the old ones with `/labelled` added.
    query, options
        Choice of scans, data set and classes; what to do with existing bags.

    Returns
    -------
    Outcome
    """
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    results.require_column("label", chosen.scans)
    bags = bags_of(chosen.scans)
    _require_bags(chosen.scans, bags)
    if topic is not None and any(len(bag.folders) > 1 for bag in bags):
        hint = f"omit {argument('topic')}"
        raise UsageError(argument("topic"), "is one name for several topics", hint=hint)
    space = chosen.space
    settings = ExportBagSettings(
        label_space=space,
        origins=results.provenance.origins(PREDICTION_STAGES),
        results=str(out.absolute()),
        topic=topic,
    )
    owned = OwnedFolder(folder, "export-bag")
    sensor = results.provenance.sensor()

    def new_cloud(file: ScanFile, message: Any, types: Types) -> Any:
        if not present(label_path(results, file)):
            return None
        values = _point_values(results.read(file, sensor, query.classes), space)
        return cloud_with_values(message, values, file.path, types)

    run = BagRun(
        results=results,
        owned=owned,
        new_topic=lambda bag, old: _new_topic(bag, old, topic),
        new_cloud=new_cloud,
    )
    with begin(owned, settings, options.overwrite):
        outcome = run.run(bags, options)
    return replace(outcome, missing=chosen.missing)


def _require_bags(scans: Sequence[ScanFile], bags: Sequence[BagOfResults]) -> None:
    """Refuse scans that are no clouds of bags, which no bag could have."""
    folders = {folder for bag in bags for folder in bag.folders}
    other = next((scan.path for scan in scans if scan.path.parent not in folders), None)
    if other is None:
        return
    hint = "run `export-ply` for clouds in files"
    if bags:
        names = tuple(sorted({bag.first.sequence for bag in bags}))
        hint = f"export the bags alone, with {setting('sequences', names)}"
    raise UsageError(other, "is no cloud of a bag", "labels of ROS bags", hint)


def _new_topic(bag: Bag, old: str, name: str | None) -> str:
    """Return the topic of the labelled clouds of a topic; refuse one that the bag has."""
    default = f"{old.rstrip('/')}/{LABELLED}"
    new = name or default
    existing = {connection.topic for connection in bag.reader.connections}
    if new not in existing:
        return new
    numbered = (f"{default}_{number}" for number in range(2, len(existing) + 3))
    free = next(topic for topic in numbered if topic not in existing)
    hint = f"give another name, such as {setting('topic', free)}"
    raise OutputError(bag.path, f"already has the topic {new}", hint=hint)


def _point_values(results: ScanResults, space: LabelSpace) -> dict[str, npt.NDArray[Any]]:
    """Return the values of the points of a labelled scan by the name of their field, each (N,).

    `label` has the type of PCL's PointXYZL, and `rgb` that of its PointXYZRGB.
    """
    if results.label is None:
        raise ValueError("a labelled scan is needed")
    values: dict[str, npt.NDArray[Any]] = {"label": results.label.astype(np.uint32)}
    if results.instance is not None:
        values["instance"] = results.instance
    values |= results.uncertainty
    colours = screen_colours(space)[space.to_train(results.label, strict=False)]
    red, green, blue = colours.astype(np.uint32).T
    values["rgb"] = (red << 16 | green << 8 | blue).view(np.float32)
    return values
