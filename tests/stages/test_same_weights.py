# SPDX-License-Identifier: MIT
"""Labels and uncertainties of different networks never stand side by side unsaid."""

import pytest
from scans import write_weights

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import LabelError, OutputError
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.storage.identity import fingerprint
from salsanext_cli.storage.predictions import provenance
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.uncertainty.settings import Estimator


@pytest.fixture
def other(tmp_path):
    return NetworkSettings(write_weights(tmp_path / "other.safetensors", seed=1), "cpu")


def test_labels_made_anew_by_other_weights_are_not_shown_with_older_uncertainty(world, other):
    predict_scans(world.data, world.out, network=world.network)
    uncertainty(world.data, world.out, network=world.network, estimator=Estimator(samples=2))
    overwrite = RunOptions(overwrite=True)
    predict_scans(world.data, world.out, network=other, options=overwrite)
    with pytest.raises(OutputError, match=r"labels by the weights .* uncertainty --overwrite"):
        export_ply(world.out, colour="epistemic", network=other)
    uncertainty(
        world.data, world.out, network=other, estimator=Estimator(samples=2), options=overwrite
    )
    assert export_ply(world.out, colour="epistemic", network=other).done == 3


def test_labels_made_step_by_step_remember_their_weights(world, other):
    sensor = world.network.load().sensor
    project_scans(world.data, world.out, sensor=sensor)
    predict_range_images(world.out, world.out, network=other)
    knn_refine_scans(world.out)
    assert provenance(world.out, ScanSelection())["weights"] == fingerprint(other.weights)
    with pytest.raises(OutputError, match="labels made with other weights"):
        uncertainty(world.data, world.out, network=world.network, estimator=Estimator(samples=2))


def test_other_classes_than_those_predicted_are_refused(world):
    predict_scans(world.data, world.out, network=world.network)
    small = {"labels": {0: "no", 1: "yes"}, "learning_map": {0: 0, 1: 1}}
    small |= {"learning_map_inv": {0: 0, 1: 1}, "name": "two"}
    with pytest.raises(LabelError, match="predictions in the classes of"):
        export_ply(world.out, space=LabelSpace.from_dict(small), network=world.network)
