# SPDX-License-Identifier: MIT
"""Scores on scans that the weights were trained on: left out, or marked."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scans import refused, write_bin, write_weights
from shallow_network import shallow  # noqa: F401
from world import World

from salsanext_cli import label_space, read_labels, read_scan
from salsanext_cli.commands.evaluation import Evaluation
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.report import read_run, report
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.measures.scores import confusion_matrix
from salsanext_cli.core.network.card import scan_digest
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.records.digest_files import with_files
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_folders import scan_names
from salsanext_cli.runs.scans.scan_search import find_scans

SPACE = label_space()
FEW_PASSES = UncertaintyMethod(samples=2, aleatoric="none")
EVERY = (("00", "000000"), ("08", "000000"), ("08", "000001"))


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return weights of the shallow network: what it computes does not matter here."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors")


@pytest.fixture
def world(world: World) -> World:
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


@pytest.fixture
def trained(world: World, tmp_path: Path) -> World:
    """Return a world whose weights were trained on one of its scans; others are gone by now."""
    source, path = world.network.path, tmp_path / "trained.safetensors"
    known = frozenset({scan_digest(read_scan(world.scan("08", "000001"))), "0" * 24})
    save_with_card(source, path, replace(read_card(source), trained_on=known))
    return replace(world, network=replace(world.network, weights=path))


def predict(world: World, **options: object) -> None:
    predict_scans(world.data, world.out, settings=world.network, **options)  # type: ignore[arg-type]


def judged(world: World) -> Evaluation:
    return evaluate_scans(find_scans(world.data), world.out, SPACE)


def counts_of(world: World, *scans: tuple[str, str]) -> np.ndarray:
    confusion = np.zeros((SPACE.class_count, SPACE.class_count), np.int64)
    for sequence, stem in scans:
        truth = read_labels(world.data / f"sequences/{sequence}/labels/{stem}.label")
        predicted = world.labels(sequence, stem)
        pair = SPACE.to_train(truth), SPACE.to_train(predicted)
        confusion += confusion_matrix(*pair, SPACE.class_count)
    return confusion


def test_they_are_left_out_under_any_name_and_format(trained, caplog):
    """Weights may have gone, scans have been renamed and their intensity changed."""
    path = trained.scan("08", "000001")
    scan = read_scan(path)
    write_bin(path, replace(scan, intensity=scan.intensity / 2))
    for old in (path, trained.data / "sequences/08/labels/000001.label"):
        old.rename(old.with_stem("renamed"))
    predict(trained)
    caplog.clear()
    trained.network.path.unlink()
    result = judged(trained)
    assert (
        result.counts.scans,
        result.counts.skipped_training_scans,
        result.counts.training_scans,
    ) == (2, 1, 0)
    np.testing.assert_array_equal(result.counts.confusion, counts_of(trained, *EVERY[:2]))
    assert caplog.messages == ["1 of 3 labelled scans skipped: the weights were trained on them"]
    assert json.loads((trained.out / "eval.json").read_text())["trained_on"] == 1


def test_scores_on_training_scans_only_are_marked(trained, caplog):
    for other in (trained.scan("00"), trained.scan("08", "000000")):
        other.unlink()
    predict(trained)
    caplog.clear()
    result = judged(trained)
    assert (
        result.counts.scans,
        result.counts.skipped_training_scans,
        result.counts.training_scans,
    ) == (1, 0, 1)
    np.testing.assert_array_equal(result.counts.confusion, counts_of(trained, EVERY[2]))
    assert caplog.messages[0].startswith("the weights were trained on every labelled scan")
    heading = (trained.out / "scores.txt").read_text().splitlines()[0]
    assert heading == "# scores on scans that the weights were trained on"
    made = report(trained.out)
    numbers = made.to_dict()
    assert (numbers["trained_on"], numbers["on_training_scans"]) == (0, True)
    assert numbers["accuracy"] == result.scores.accuracy
    assert "labelled points, 1 scan trained on" in made.page.read_text("utf-8")


def test_a_report_leaves_out_the_same(trained):
    predict(trained)
    made = report(trained.out)
    numbers = made.to_dict()
    assert (numbers["trained_on"], numbers["on_training_scans"]) == (1, False)
    assert numbers["accuracy"] == judged(trained).scores.accuracy
    rows, _ = read_run(trained.out)
    assert [row.confusion.any() for row in rows.rows] == [True, True, False]


REPLACED = RunOptions(overwrite=True)  # `knn-refine` replaces the labels of `predict`.
RISK = {"kind": "error", "threshold": 0.5, "at_most": 0.1, "confidence": None}
RISK |= {"scans": 3, "sequences": ["00"], "digests": "all"}


@pytest.mark.parametrize("change", [{"trained_on": "all"}, {"reject": 0.5, "guarantee": RISK}])
def test_a_record_that_was_changed_is_refused(trained, change):
    predict(trained)
    record = json.loads((trained.out / "predict.json").read_text())
    record["settings"] |= change
    (trained.out / "predict.json").write_text(json.dumps(record))
    refused(OutputError, trained.out / "predict.json", judged, trained)


def digest_file(world: World) -> Path:
    """Return the only file of digests in an output folder."""
    (path,) = world.out.glob("digests-*.digests")
    return path


def test_the_digests_are_in_a_file_that_the_record_names(trained):
    """The name contains their SHA-256, so a run with the same weights finds the same name."""
    predict(trained)
    path = digest_file(trained)
    known = read_card(trained.network.path).trained_on
    assert path.read_text("ascii").splitlines() == sorted(known)
    expected = hashlib.sha256("".join(sorted(known)).encode()).hexdigest()[:16]
    assert path.stem == f"digests-{expected}"
    assert not scan_names([path.name])
    record = json.loads((trained.out / "predict.json").read_text())
    assert record["settings"]["trained_on"] == path.name
    before = (trained.out / "predict.json").read_bytes()
    predict(trained)
    assert (trained.out / "predict.json").read_bytes() == before
    assert digest_file(trained) == path
    assert judged(trained).counts.skipped_training_scans == 1


def test_a_record_of_an_early_version_holds_them_itself(trained):
    predict(trained)
    path = trained.out / "predict.json"
    record = json.loads(path.read_text())
    record["settings"]["trained_on"] = digest_file(trained).read_text("ascii").replace("\n", "")
    digest_file(trained).unlink()
    path.write_text(json.dumps(record))
    assert judged(trained).counts.skipped_training_scans == 1
    predict(trained)  # With the same settings
    assert json.loads(path.read_text()) == record


@pytest.mark.parametrize("content", [b"", b"0" * 24, b"\xff"])
def test_a_changed_file_of_digests_is_refused_where_scans_are_compared(trained, content):
    """Scans of the training would count otherwise."""
    predict(trained)
    path = digest_file(trained)
    path.write_bytes(content)
    export_ply(trained.out)
    refused(OutputError, path, judged, trained)
    path.unlink()
    predict(trained)  # Writes the file again, as the hint of a missing one says.
    assert judged(trained).counts.skipped_training_scans == 1


def test_without_the_file_of_digests_only_the_comparison_with_them_is_missing(trained, caplog):
    predict(trained, extras=("pixel_labels", "probabilities"))
    path = digest_file(trained)
    path.unlink()
    knn_refine_scans(trained.out, options=REPLACED)
    uncertainty(trained.data, trained.out, settings=trained.network, method=FEW_PASSES)
    path.unlink()  # `uncertainty` names the same file.
    export_ply(trained.out)
    caplog.clear()
    result = judged(trained)
    assert [str(path) in message for message in caplog.messages].count(True) == 1
    assert (result.counts.scans, result.counts.skipped_training_scans) == (3, 0)
    numbers = json.loads((trained.out / "eval.json").read_text())
    assert (numbers["trained_on"], numbers["on_training_scans"]) == (None, None)
    assert (trained.out / "scores.txt").read_text().startswith("# ")
    made = report(trained.out)
    assert made.to_dict()["trained_on"] is None
    assert path.name in made.page.read_text("utf-8")


@pytest.mark.slow
def test_the_scans_of_a_threshold_are_unknown_without_their_file(trained, caplog):
    digests = {scan_digest(read_scan(trained.scan("08", "000001")))}
    predict(trained)
    path = trained.out / "predict.json"
    record = json.loads(path.read_text())
    risk = RISK | {"digests": "".join(digests)}
    settings = record["settings"] | {"reject": 0.5, "guarantee": risk}
    record["settings"] = with_files(settings, trained.out)
    path.write_text(json.dumps(record))
    assert judged(trained).counts.threshold_scans == 0  # That scan is skipped.
    named = trained.out / record["settings"]["guarantee"]["digests"]
    assert Provenance(trained.out).scans_of_threshold().digests == digests
    named.unlink()
    caplog.clear()
    judged(trained)
    assert [message for message in caplog.messages if str(named) in message]


def test_a_later_stage_runs_again_after_the_file_of_digests_has_gone_and_come_back(trained):
    """The settings of `predict` stay the same settings."""
    predict(trained, extras=("pixel_labels",))
    knn_refine_scans(trained.out, options=REPLACED)
    path = digest_file(trained)
    content = path.read_bytes()
    path.unlink()
    knn_refine_scans(trained.out)
    path.write_bytes(content)
    knn_refine_scans(trained.out)


def test_records_of_early_versions_stay_as_they_are_when_scans_are_added(trained):
    """Later stages recorded the digest of the settings as they were written."""
    first = trained.scan("08", "000000")
    predict_scans(first, trained.out, settings=trained.network)
    path = trained.out / "predict.json"
    record = json.loads(path.read_text())
    joined = digest_file(trained).read_text("ascii").replace("\n", "")
    record["settings"]["trained_on"] = joined
    digest_file(trained).unlink()
    path.write_text(json.dumps(record))
    before = Provenance(trained.out).origins(["predict"])
    expected = json.dumps(record["settings"], sort_keys=True)
    assert before["predict"] == hashlib.sha256(expected.encode()).hexdigest()[:12]
    predict(trained)
    assert json.loads(path.read_text())["settings"]["trained_on"] == joined
    assert Provenance(trained.out).origins(["predict"]) == before
    assert judged(trained).counts.skipped_training_scans == 1


def test_a_file_of_digests_with_the_former_suffix_is_read(trained):
    predict(trained)
    path = digest_file(trained)
    former = path.rename(path.with_suffix(".txt"))
    record = (trained.out / "predict.json").read_text().replace(path.name, former.name)
    (trained.out / "predict.json").write_text(record)
    assert judged(trained).counts.skipped_training_scans == 1
    predict(trained)  # With the same settings
