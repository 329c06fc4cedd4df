# SPDX-License-Identifier: MIT
"""Lines that `pick` prints: what its numbers mean, what labelling gave before, and what is next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.core.measures.label_gains import gains_of_trials

if TYPE_CHECKING:
    from salsanext_cli.commands.line.picked_labels import PickedLabels
    from salsanext_cli.commands.stages.pick import Picking
    from salsanext_cli.runs.labelling.picked_data_set import UncertaintyScale


def lines_after_pick(
    out: Path,
    picking: Picking,
    labels: PickedLabels,
    weights: Path | str | None,
    labelled: Sequence[Path],
    tool_folder: Path | None = None,
) -> Iterator[str]:
    """Yield the lines about picked scans in a data set.

    `labelled`: data sets that have labels; `tool_folder`: folder of the files of a labelling tool.
    """
    scale = picking.scale
    if scale is not None and scale.least < scale.most:
        yield scale_text(scale)
        if any(scan.distance is not None for scan in picking.picked):
            yield "distance: 0 is an equal scan, 1 the usual distance of two of these scans"
    if labels.verdict is not None:
        yield f"the picked scans: {labels.verdict.sentence}"
    for gains in gains_of_trials(labels.accuracy):
        yield f"does it pay? {gains.text}"
    yield f"next: {shlex.join(['salsanext', 'report', str(out)])}"
    commands = commands_after_pick(out, weights, labelled)
    if tool_folder is not None:
        yield f"for the labelling tool: {tool_folder}"
    yield f"to label: save the corrected clouds in the folder edited, then {commands}"


def commands_after_pick(out: Path, weights: Path | str | None, labelled: Sequence[Path]) -> str:
    """Return the commands that import corrected labels and train on them."""
    edited = ["salsanext", "import-labels", "edited", str(out)]
    training = ["salsanext", "train", str(out), "runs/mine", "--recipe", "finetune"]
    if weights:
        training += ["--weights", str(weights)]
    for dataset in labelled:
        training += ["--also", str(dataset)]
    return f"`{shlex.join(edited)}`, then `{shlex.join(training)}`"


def scale_text(scale: UncertaintyScale) -> str:
    """Return what an uncertainty means among the scans of a run."""
    most = math.log(scale.class_count)
    return (
        f"uncertainty of all scans: {scale.least:.4f} to {scale.most:.4f} nats, median "
        f"{scale.median:.4f}; 0 is certain, {most:.2f} the most that is possible"
    )
