# SPDX-License-Identifier: MIT
"""Commands and options of earlier versions, and their replacements."""

from collections.abc import Sequence
from itertools import pairwise

from salsanext_cli.commands.line.output.console import guarded
from salsanext_cli.core.errors import UsageError

USE_PREDICT = "run `predict` with it on your own scans, or on those that `synth` writes"
RATES_ARE_TRIED = "omit it: `tune dropout` tries ten rates from 0.02 to 0.5"
FITTED_IN_FLOAT32 = "omit it: `tune int8` fits the ranges in float32 on the CPU"
ALL_COMMANDS = ""
REMOVED_COMMANDS = {"export-rrd": "use examples/rerun_recording.py"}
"""Hint by the name of a command."""
REMOVED_OPTIONS = {
    ALL_COMMANDS: {
        "--backend": "use `--jobs`, or `--cluster` for Ray",
        "--out": "give the folder as the argument OUT",
        "--scheduler": "use `--cluster` for Ray, or `--shard I/N` on each machine",
    },
    "demo": {
        "--engine": USE_PREDICT,
        "--intensity": USE_PREDICT,
        "--precision": USE_PREDICT,
        "--weights": USE_PREDICT,
    },
    "dropout": {
        "--highest": RATES_ARE_TRIED,
        "--lowest": RATES_ARE_TRIED,
        "--seed": RATES_ARE_TRIED,
        "--steps": RATES_ARE_TRIED,
    },
    "export-onnx": {"--int8": "quantise the exported model with other software"},
    "export-ply": {
        "--format": "omit it: clouds are PLY; `export-las` writes LAS and LAZ",
        "--map": "use examples/drive_map.py",
        "--map-voxel": "use examples/drive_map.py --voxel",
        "--max-error": "use `predict --reject`, or `filter --max-error`",
    },
    "filter": {
        "--by-class": "use `--keep` once for each class",
        "--indices": "select points by their labels and errors with numpy",
        "--split": "use `--keep` once for each class, or --sequences to select scans",
        "--to": "give the folder as the second argument: filter OUT TARGET",
    },
    "fuse": {"--strict": "use the key `warnings` of `--json`"},
    "int8": {
        "--device": FITTED_IN_FLOAT32,
        "--engine": FITTED_IN_FLOAT32,
        "--precision": FITTED_IN_FLOAT32,
    },
    "knn-refine": {"--labels": "write the labels as `pixel_labels` of the output of `project`"},
    "pick": {
        "--limit": "use `--subset`",
        "--strategy": "omit it: `pick` chooses by the measured best strategy",
    },
    "picture": {"--gif": "use ffmpeg on the pictures"},
    "report": {"--by-distance": "use `eval --by-distance`"},
    "risk": {"--per-class": "use one threshold for all classes; a lower --at-most rejects more"},
    "train": {
        "--columns": "write `columns` in a file for --sensor",
        "--strict": "use the key `warnings` of `--json`",
    },
    "tune": {"--limit": "use `--subset`"},
    "uncertainty": {"--method": "use fewer passes, such as `--samples 5`, to save time"},
    "view": {"--by-distance": "use `eval --by-distance`"},
}
"""Hint by command and option, with the value of the option if other values remain."""


@guarded
def refuse_removed(commands: Sequence[str], words: Sequence[str], *, json: bool) -> None:
    """Refuse a removed command, or option of a command or its group; `guarded` reads `json`."""
    for command in commands:
        if command in REMOVED_COMMANDS:
            hint = REMOVED_COMMANDS[command]
            raise UsageError(command, "this command was removed", hint=hint)
    texts = _typed_texts(words)
    for command in (ALL_COMMANDS, *commands):
        for option, hint in REMOVED_OPTIONS.get(command, {}).items():
            if option in texts:
                raise UsageError(option, "this option was removed", hint=hint)


def _typed_texts(words: Sequence[str]) -> set[str]:
    """Return the words of a command line, and the pairs of neighbours such as an option's value.

    ``--option=value`` is two words.
    """
    texts: list[str] = []
    for word in words:
        texts += word.split("=", maxsplit=1)
    pairs = [f"{first} {second}" for first, second in pairwise(texts)]
    return {*texts, *pairs}
