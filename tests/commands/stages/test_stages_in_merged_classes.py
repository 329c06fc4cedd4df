# SPDX-License-Identifier: MIT
"""Stages in merged classes: files, comparisons, and contradictions."""

import json
from dataclasses import replace

import numpy as np
import plyfile
import pytest
import yaml
from scans import SMALL, labels_below, refused, write_weights

from salsanext_cli import LabelSpace, knn_refine, label_space, project, read_labels, read_scan
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.picture import picture
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.measures.histograms import confidence_histogram
from salsanext_cli.core.measures.scores import confusion_matrix
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.formats.kitti_labels import write_labels
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_selection import ScanSelection

FULL, COARSE = label_space(), label_space("coarse")
MERGING = ClassMerging.between(FULL, COARSE)
FEW = UncertaintyMethod(samples=2)
ONE = ScanSelection(sequences=("00",))


@pytest.fixture
def coarse(world):
    """Return the world with a network of merged classes."""
    return replace(world, network=replace(world.network, classes=COARSE))


def predict(world, **options):
    return predict_scans(world.data, world.out, settings=world.network, **options)


def compare(world, **options):
    scans, space = ResultFolder(world.out).predicted(ScanSelection(), **options)
    return evaluate_scans(scans, world.out, space, labels=options.get("space"))


def truth_of(world, sequence="08", stem="000000"):
    return read_labels(world.data / f"sequences/{sequence}/labels/{stem}.label")


def test_labels_are_of_the_largest_sum_after_the_vote_in_merged_classes(coarse, world):
    assert predict(coarse, extras=("pixel_labels", "probabilities")).done == 3
    image = project(read_scan(coarse.scan()), SMALL)
    softmax = world.network.load().probabilities(image)
    sums = np.stack([sum(softmax[i] for i in group) for group in MERGING.groups])
    pixels = np.load(coarse.result("pixel_labels"))
    assert (pixels == sums.argmax(axis=0)).mean() > 0.999
    assert (pixels.dtype, pixels.max()) == (np.uint8, 7)
    expected = COARSE.to_raw(knn_refine(image, pixels, 8))
    np.testing.assert_array_equal(coarse.labels(), expected)
    least = 1 - sums.max(axis=0).ravel()[image.pixel_of_point]
    confidence = np.load(coarse.result("uncertainty/least_confidence"))
    np.testing.assert_allclose(confidence, least, atol=1e-6)
    of_points = np.load(coarse.result("probabilities"))
    assert of_points.shape == (1500, 8)
    np.testing.assert_allclose(of_points, sums.reshape(8, -1)[:, image.pixel_of_point].T, atol=2e-3)
    recorded = json.loads((coarse.out / "predict.json").read_text())["settings"]
    assert recorded["label_space"]["name"] == "coarse"


def test_the_pixel_way_gives_the_same_bytes(coarse, tmp_path):
    predict(coarse)
    parts = tmp_path / "parts"
    project_scans(coarse.data, parts, sensor=SMALL)
    predict_range_images(parts, parts, settings=coarse.network)
    knn_refine_scans(parts)
    assert labels_below(parts) == labels_below(coarse.out)
    assert len(labels_below(parts)) == 3
    with pytest.raises(UsageError):
        knn_refine_scans(parts, space=FULL, options=RunOptions(overwrite=True))


def test_labels_are_compared_in_the_classes_of_the_predictions(coarse):
    """The data set may describe finer labels; its splits count."""
    data = FULL.to_dict() | {"split": {"valid": ["00", "08"], "train": []}}
    (coarse.data / "labels.yaml").write_text(yaml.safe_dump(data))
    predict(coarse)
    evaluation = compare(coarse)
    expected = np.zeros((8, 8), np.int64)
    for sequence, stem in (("00", "000000"), ("08", "000000"), ("08", "000001")):
        raw = coarse.labels(sequence, stem)
        truth = COARSE.to_train(truth_of(coarse, sequence, stem))
        expected += confusion_matrix(truth, COARSE.to_train(raw), 8)
    np.testing.assert_array_equal(evaluation.counts.confusion, expected)
    assert evaluation.space.fits(COARSE)
    valid, _ = ResultFolder(coarse.out).predicted(ScanSelection(split="valid"))
    assert len(valid) == 3
    with pytest.raises(UsageError):
        compare(coarse, classes=FULL)


def test_full_predictions_and_their_probabilities_are_merged_by_eval(world):
    predict(world, extras=("probabilities",))
    full, merged = compare(world), compare(world, classes=COARSE)
    assert (full.space.class_count, merged.space.name) == (20, "coarse")
    expected, points, brier = np.zeros((8, 8), np.int64), 0, 0.0
    for sequence, stem in (("00", "000000"), ("08", "000000"), ("08", "000001")):
        truth = COARSE.to_train(truth_of(world, sequence, stem))
        expected += confusion_matrix(truth, COARSE.to_train(world.labels(sequence, stem)), 8)
        softmax = np.load(world.result("probabilities", sequence, stem)).astype(np.float64)
        counts = (truth > 0) & (softmax[:, 0] < 1)
        sums = np.stack([softmax[:, list(group)].sum(axis=1) for group in MERGING.groups], axis=1)
        brier += confidence_histogram(sums[counts], truth[counts]).scan_sums["brier"][0]
        points += counts.sum()
    np.testing.assert_array_equal(merged.counts.confusion, expected)
    scores = merged.uncertainty.calibration
    assert scores.brier == pytest.approx(brier / points, rel=1e-4)
    assert scores.points == points
    # The files of `least_confidence` are of classes before merging, the sums of merged classes.
    before, after = (e.uncertainty.kinds["least_confidence"].mean for e in (full, merged))
    assert after < before


def test_labels_of_other_raw_ids_count_where_the_names_of_the_classes_are_the_same(coarse):
    """Those of nuScenes, for example, mean other classes than SemanticKITTI's."""
    ids = {0: 0} | {k: 20 + k for k in range(1, 8)}
    labels = {ids[k]: name for k, name in enumerate(COARSE.names)}
    other = LabelSpace.from_dict(
        {
            "name": "others",
            "labels": labels,
            "learning_map": {raw: k for k, raw in ids.items()} | {10: 7, 5: 0},
            "learning_map_inv": ids,
        }
    )
    predict(coarse)
    alike = compare(coarse)
    expected = alike.counts.confusion
    assert "label_space_of_labels" not in alike.settings
    for path in coarse.data.rglob("labels/*.label"):
        write_labels(path, other.to_raw(COARSE.to_train(read_labels(path))))
    evaluation = compare(coarse, space=other)
    np.testing.assert_array_equal(evaluation.counts.confusion, expected)
    for result in (evaluation.to_dict(), json.loads((coarse.out / "eval.json").read_text())):
        recorded = result["settings"]["label_space_of_labels"]
        assert LabelSpace.from_dict(recorded).learning_map == other.learning_map
        assert result["settings"]["label_space"]["name"] == "coarse"
    (coarse.data / "labels.yaml").write_text(yaml.safe_dump(other.to_dict()))
    np.testing.assert_array_equal(compare(coarse).counts.confusion, expected)
    # Clouds and pictures compare the same, in the raw ids of the predictions.
    assert not picture(coarse.out, colours=["wrong"], query=ResultQuery(selection=ONE)).failures
    export_ply(coarse.out)
    cloud = plyfile.PlyData.read(coarse.result("ply"))["vertex"]
    truth = COARSE.to_raw(other.to_train(truth_of(coarse)))
    np.testing.assert_array_equal(cloud["scalar_truth"], truth)
    right = cloud["scalar_label"] == cloud["scalar_truth"]
    np.testing.assert_array_equal(cloud["scalar_wrong"][truth > 0], ~right[truth > 0])


def test_uncertainty_beside_labels_has_their_classes(coarse, world):
    predict(coarse, selection=ONE)
    more = {"method": FEW, "selection": ONE}
    with pytest.raises(OutputError):
        uncertainty(world.data, world.out, settings=world.network, **more)
    assert uncertainty(coarse.data, coarse.out, settings=coarse.network, **more).done == 1
    assert np.nanmax(np.load(coarse.result("uncertainty/entropy", "00"))) <= np.log(8) + 1e-5
    paper = UncertaintyMethod(samples=2, aleatoric="paper")
    with pytest.raises(UsageError, match="merged") as caught:
        uncertainty(coarse.data, coarse.out, settings=coarse.network, method=paper)
    assert caught.value.subject == "aleatoric"
    assert 'aleatoric="copies"' in caught.value.hint
    predict(world, selection=ONE, options=RunOptions(overwrite=True))
    refused(OutputError, coarse.out, export_ply, coarse.out, colour="entropy")


NOT_IN_LABELS = {
    "learning_map": {raw: i for raw, i in FULL.learning_map.items() if raw != 13},
    "learning_map_inv": FULL.learning_map_inv | {5: 13},
}


def test_classes_that_cannot_be_merged_are_compared_unmerged(world, tmp_path):
    """A raw id may stand for a class that labels do not have."""
    space = LabelSpace.from_dict(FULL.to_dict() | NOT_IN_LABELS | {"name": "mine"})
    weights = write_weights(tmp_path / "mine.safetensors", space=space)
    world = replace(world, network=replace(world.network, weights=weights))
    (world.data / "labels.yaml").write_text(yaml.safe_dump(space.to_dict()))
    predict(world, selection=ONE)
    settings = json.loads((world.out / "predict.json").read_text())["settings"]
    recorded = LabelSpace.from_dict(settings["label_space"])
    scans, compared = ResultFolder(world.out).predicted(ScanSelection(), classes=recorded)
    assert (len(scans), compared.fits(space)) == (1, True)


def test_the_same_classes_are_the_same_settings(world):
    predict(world)
    same = replace(world, network=replace(world.network, classes=FULL))
    assert predict(same).skipped == 3
    coarse = replace(world, network=replace(world.network, classes=COARSE))
    refused(OutputError, world.out / "predict.json", predict, coarse)
