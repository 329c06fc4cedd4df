# SPDX-License-Identifier: MIT
"""Lines that `pick` prints: what its numbers mean, what labelling gave before, and what is next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.core.measures.label_gains import gains_of_trials
from salsanext_cli.runs.scans.layouts import TOOL_FOLDER

if TYPE_CHECKING:
    from salsanext_cli.commands.picked_labels import PickedLabels
    from salsanext_cli.commands.stages.pick import Picking
    from salsanext_cli.io.annotation_tools.tool import AnnotationTool
    from salsanext_cli.runs.annotation.picked_data_set import UncertaintyScale


def lines_after_pick(
    out: Path,
    picking: Picking,
    labels: PickedLabels,
    weights: Path | str | None,
    labelled: Sequence[Path],
    tool: AnnotationTool | None = None,
) -> Iterator[str]:
    """Yield the lines about picked scans in a data set.

    `labelled`: data sets that have labels; `tool`: labelling tool that the scans are written for.
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
    edited = Path("edited")
    saving = f"save the corrected clouds in the folder {edited}"
    if tool is not None:
        folder = out / TOOL_FOLDER / tool.name
        yield f"for the labelling tool: {folder}"
        saving = f"save what the tool returns in the folder {edited}"
        if tool.edits_in_place:
            edited = folder
            saving = "open the scans in the tool and save them"
    yield f"to label: {saving}, then {commands_after_pick(out, edited, weights, labelled)}"


def commands_after_pick(
    out: Path, edited: Path, weights: Path | str | None, labelled: Sequence[Path]
) -> str:
    """Return the commands that import corrected labels and train on them."""
    importing = ["salsanext", "import-labels", str(edited), str(out)]
    training = ["salsanext", "train", str(out), "runs/mine", "--recipe", "finetune"]
    if weights:
        training += ["--weights", str(weights)]
    for dataset in labelled:
        training += ["--also", str(dataset)]
    return f"`{shlex.join(importing)}`, then `{shlex.join(training)}`"


def scale_text(scale: UncertaintyScale) -> str:
    """Return what an uncertainty means among the scans of a run."""
    most = math.log(scale.class_count)
    return (
        f"uncertainty of all scans: {scale.least:.4f} to {scale.most:.4f} nats, median "
        f"{scale.median:.4f}; 0 is certain, {most:.2f} the most that is possible"
    )
