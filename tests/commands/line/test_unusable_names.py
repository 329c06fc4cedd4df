# SPDX-License-Identifier: MIT
"""Names that the system cannot look up, like those in a folder without permission."""

from command_line import subject

LONG = "a" * 300
"""Too long for any file system, also for the superuser."""


COMMANDS = [
    (("predict", "{data}", "{out}", "--sensor", LONG), 2),
    (("predict", "{data}", "{out}", "--weights", LONG), 1),
    (("predict", "{data}", "{out}", "--weights", f"{LONG}.onnx"), 1),
    (("predict", LONG, "{out}"), 1),
    (("predict", "{data}", LONG), 1),
    (("train", LONG, "{out}"), 1),
    (("train", "{data}", "{out}", "--recipe", LONG), 2),
    (("knn-refine", LONG), 1),
    (("eval", LONG), 1),
    (("eval", "{done}", "--label-space", LONG), 2),
    (("export-ply", LONG), 1),
    (("picture", LONG), 1),
    (("picture", "{done}", "--dataset", LONG), 1),
    (("picture", LONG, "--dataset", "{data}"), 1),
    (("submit", LONG, "made.zip"), 1),
    (("submit", "{done}", "made.zip", "--description", LONG), 1),
    (("convert", LONG, "{out}"), 1),
    (("pick", LONG, "{out}"), 1),
    (("pick", "{data}", LONG), 1),
    (("import-labels", LONG, "{data}"), 1),
    (("import-labels", "{done}", LONG), 1),
    (("import-labels", "{done}", "{data}", "--map", LONG), 2),
    (("inspect", LONG), 1),
]


def test_such_a_name_is_one_error(run, data, weights, take_by_default, tmp_path):
    take_by_default(weights)
    done = tmp_path / "done"
    labels = done / "sequences/08/predictions"
    labels.mkdir(parents=True)
    (labels / "000000.label").write_bytes(bytes(4))
    places = {"data": data, "out": tmp_path / "out", "done": done}
    for command, status in COMMANDS:
        result = run(*(word.format(**places) for word in command))
        assert isinstance(result.exception, SystemExit), command
        assert (result.exit_code, LONG in subject(result)) == (status, True), command
