# SPDX-License-Identifier: MIT
"""Results of a run for its page: rows, facts, clouds."""

from evaluation_runs import run_of
from scans import SMALL, refused

from salsanext_cli import label_space
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.geometry.objects import BOX
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import default_weights, read_card
from salsanext_cli.report.page.run_results import read_boxes
from salsanext_cli.runs.results.manifest import Manifest, StageRecord


def record(out, stage, folders, **settings):
    shared = {"label_space": label_space().to_dict(), "sensor": SMALL.to_dict()}
    Manifest(out).write(StageRecord(stage=stage, settings=shared | settings, writes=folders))


def test_the_default_weights_are_described(tmp_path):
    record(
        *(tmp_path, "predict", ("predictions",)),
        **{"weights": fingerprint(default_weights()), "engine": "openvino"},
        **{"precision": "bfloat16", "temperature": 1.25, "reject": 0.3},
    )
    facts = dict(run_of(tmp_path).facts())
    start = read_card(default_weights()).description.replace("`", "").partition(" See ")[0]
    assert start in facts["Weights"]
    # A mailed page has no links to the documentation.
    assert ".md" not in facts["Weights"]
    assert "Not for use on real roads." in facts["Weights"]
    assert facts["Sensor"].startswith("small, 16×128, field of view +3° to -25°")
    assert "openvino in bfloat16, temperature 1.25" in facts["Labels"]
    assert facts["Labels"].endswith("rejected: error above 0.3")
    assert "Uncertainty" not in facts


def test_other_weights_are_named_by_their_digest_if_it_is_recorded(tmp_path):
    assert dict(run_of(tmp_path).facts())["Weights"] == "not recorded"
    record(
        *(tmp_path, "uncertainty", ("uncertainty/epistemic",)),
        **{"weights": "ab" * 32, "method": "sampling", "samples": 30, "aleatoric": "copies"},
    )
    facts = dict(run_of(tmp_path).facts())
    assert facts["Weights"].startswith("SHA-256 abababababab, not the default weights")
    assert facts["Uncertainty"] == "sampling, samples 30, aleatoric copies"


def test_boxes_are_read_from_the_table_or_it_is_refused(tmp_path):
    path, space = tmp_path / "000000.csv", label_space()
    assert read_boxes(path, space) == []
    head = f"object,class,points,{','.join(BOX)}\n"
    path.write_text(f"{head}1,car,12,1,2,3,4,2,1.5,-0.5\n2,merged,9,0,0,0,1,1,1,0\n")
    car = space.names.index("car")
    assert read_boxes(path, space) == [[car, 1, 2, 3, 4, 2, 1.5, -0.5], [0, 0, 0, 0, 1, 1, 1, 0]]
    for damaged in ("1,car,12,1,2,3,4,2,1.5,nan", "1,car,12,1,2", "1,car,12,1,2,3,4,2,1.5,wide"):
        path.write_text(head + damaged)
        refused(FormatError, path, read_boxes, path, space)
