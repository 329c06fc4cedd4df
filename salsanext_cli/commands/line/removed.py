# SPDX-License-Identifier: MIT
"""Commands and options of earlier versions, and their replacements."""

from collections.abc import Sequence
from itertools import pairwise

from salsanext_cli.commands.line.console import guarded
from salsanext_cli.core.errors import UsageError

OF_DEMO = "run `predict` with it on your own scans, or on those that `synth` writes"
OF_DROPOUT = "omit it: `tune dropout` tries ten rates from 0.02 to 0.5"
OF_INT8 = "omit it: `tune int8` fits the ranges in float32 on the CPU"
REMOVED = {
    ("", "--backend"): "use `--jobs`",
    ("", "--out"): "give the folder as the argument OUT",
    ("", "--scheduler"): "use `--shard I/N` on each machine",
    ("compare", ""): "use `eval` on both folders, then examples/compare_runs.py",
    ("demo", "--engine"): OF_DEMO,
    ("demo", "--intensity"): OF_DEMO,
    ("demo", "--precision"): OF_DEMO,
    ("demo", "--weights"): OF_DEMO,
    ("dropout", "--highest"): OF_DROPOUT,
    ("dropout", "--lowest"): OF_DROPOUT,
    ("dropout", "--seed"): OF_DROPOUT,
    ("dropout", "--steps"): OF_DROPOUT,
    ("export-onnx", "--int8"): "quantise the exported model with other software",
    ("export-ply", "--format"): "omit it: clouds are PLY, which PDAL converts to LAS or LAZ",
    ("export-ply", "--map"): "use examples/drive_map.py",
    ("export-ply", "--map-voxel"): "use examples/drive_map.py --voxel",
    ("export-ply", "--max-error"): "use `predict --reject`, or `filter --max-error`",
    ("export-rrd", ""): "use examples/rerun_recording.py",
    ("filter", "--by-class"): "use `--keep` once for each class",
    ("filter", "--indices"): "select points by their labels and errors with numpy",
    ("filter", "--split"): "use `--keep` once for each class, or --sequences to select scans",
    ("filter", "--to"): "give the folder as the second argument: filter OUT TARGET",
    ("fuse", "--strict"): "use the key `warnings` of `--json`",
    ("int8", "--device"): OF_INT8,
    ("int8", "--engine"): OF_INT8,
    ("int8", "--precision"): OF_INT8,
    ("knn-refine", "--labels"): "write the labels as `pixel_labels` of the output of `project`",
    ("pick", "--limit"): "use `--subset`",
    ("pick", "--strategy"): "omit it: `pick` chooses by the measured best strategy",
    ("picture", "--gif"): "use ffmpeg on the pictures",
    ("report", "--by-distance"): "use `eval --by-distance`",
    ("risk", "--per-class"): "use one threshold for all classes; a lower --at-most rejects more",
    ("train", "--columns"): "write `columns` in a file for --sensor",
    ("train", "--strict"): "use the key `warnings` of `--json`",
    ("tune", "--limit"): "use `--subset`",
    ("uncertainty", "--method"): "use fewer passes, such as `--samples 5`, to save time",
    ("view", "--by-distance"): "use `eval --by-distance`",
}
"""Hint by command and option, with its value if other values remain; "" stands for all commands, or
for the command itself."""


@guarded
def refuse_removed(commands: Sequence[str], words: Sequence[str], *, json: bool) -> None:
    """Refuse a removed command, or option of a command or its group; `guarded` reads `json`."""
    parts = [part for word in words for part in word.split("=", 1)]
    given = {*parts, *map(" ".join, pairwise(parts))}
    for (name, option), hint in REMOVED.items():
        if name in ("", *commands) and (option in given or not option):
            kind = "option" if option else "command"
            raise UsageError(option or name, f"this {kind} was removed", hint=hint)
