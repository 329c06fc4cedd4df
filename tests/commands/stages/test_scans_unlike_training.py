# SPDX-License-Identifier: MIT
"""Stages with scans unlike training: their intensity is matched and their gaps are filled."""

from dataclasses import replace

import numpy as np
import pytest
from scans import (
    SMALL,
    labels_below,
    refused,
    share_alike,
    write_bin,
    write_sequence,
    write_weights,
)
from shallow_network import shallow  # noqa: F401

from salsanext_cli import Scan, knn_refine, project, read_scan
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.geometry.intensity import intensity_quantiles
from salsanext_cli.core.geometry.row_gaps import fill_rows, row_gaps
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.scans.scan_selection import ScanSelection

TRAINED = tuple(np.linspace(0, 1, INTENSITY_LEVELS) ** 2)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Return weights of the shallow network: what it computes does not matter here."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors")


@pytest.fixture(scope="module")
def matched_weights(tmp_path_factory):
    """Return weights that state the intensity of their training."""
    sensor = replace(SMALL, intensity_quantiles=TRAINED)
    folder = tmp_path_factory.mktemp("matched")
    return write_weights(folder / "with-intensity.safetensors", sensor=sensor)


@pytest.fixture
def matched_world(world, matched_weights):
    """Return the world with such weights."""
    network = replace(world.network, weights=matched_weights, intensity="auto")
    return replace(world, network=network)


def run(world, out=None, source=None, **options):
    return predict_scans(source or world.data, out or world.out, settings=world.network, **options)


def copy_scans(world, folder, sequences, change):
    """Copy the scans of the world, changed in some sequences; return the data set."""
    for file in sorted(world.data.rglob("*.bin")):
        scan = read_scan(file)
        relative = file.relative_to(world.data)
        sequence = relative.parts[1]
        copy = folder / relative
        copy.parent.mkdir(parents=True, exist_ok=True)
        write_bin(copy, change(scan) if sequence in sequences else scan)
    return folder


def with_intensity(intensity):
    """Return a function that gives a scan other intensities."""
    return lambda scan: Scan(scan.points, np.asarray(intensity(scan), np.float32))


def scaled(world, folder, scale):
    """Write the scans of the world with another scale of intensity; return the data set."""
    return copy_scans(
        world, folder, ["00", "08"], with_intensity(lambda scan: scale * scan.intensity)
    )


@pytest.mark.parametrize("scale", [100, 255, 65535])
def test_labels_do_not_depend_on_the_scale_of_the_files(matched_world, tmp_path, scale):
    """Percent, bytes as View of Delft writes them, and 16 bits."""
    run(matched_world)
    large = scaled(matched_world, tmp_path / "large", scale)
    run(matched_world, tmp_path / "matched", large)
    raw = replace(matched_world, network=replace(matched_world.network, intensity="raw"))
    run(raw, tmp_path / "raw", large)
    assert share_alike(matched_world.out, tmp_path / "matched") > 0.999
    assert share_alike(matched_world.out, tmp_path / "raw") < 0.95


@pytest.mark.usefixtures("workers_in_process")
def test_step_by_step_in_shards_and_by_workers_the_bytes_are_the_same(matched_world, tmp_path):
    run(matched_world)
    steps = tmp_path / "steps"
    project_scans(matched_world.data, steps, sensor=SMALL)
    predict_range_images(steps, steps, settings=matched_world.network)
    knn_refine_scans(steps)
    for number in (1, 2):
        run(matched_world, tmp_path / "shards", options=RunOptions(shard=Shard(number, 2)))
    run(matched_world, tmp_path / "workers", options=RunOptions(jobs=2))
    expected = labels_below(matched_world.out)
    assert len(expected) == 3
    for other in (steps, tmp_path / "shards", tmp_path / "workers"):
        assert labels_below(other) == expected


def test_scans_that_come_later_are_matched_as_the_first_ones(matched_world):
    run(matched_world)
    images = [
        project(read_scan(p), SMALL).channels for p in sorted(matched_world.data.rglob("*.bin"))
    ]
    before = Manifest(matched_world.out).settings("predict").sensor
    assert before.intensity_quantiles == intensity_quantiles(images)
    write_sequence(matched_world.data / "sequences/09", ["000000"], seed=99)
    assert run(matched_world).done == 1
    assert Manifest(matched_world.out).settings("predict").sensor == before
    few = UncertaintyMethod(samples=2, aleatoric="none")
    uncertainty(matched_world.data, matched_world.out, settings=matched_world.network, method=few)
    assert Manifest(matched_world.out).settings("uncertainty").sensor == before


def test_the_fit_does_not_depend_on_the_selection(matched_world, tmp_path):
    dark = copy_scans(
        matched_world,
        tmp_path / "data",
        ["00"],
        with_intensity(lambda scan: 0.3 * scan.intensity**3),
    )
    run(matched_world, source=dark)
    expected = labels_below(matched_world.out)
    assert len(expected) == 3
    for number, first in enumerate((ScanSelection("valid"), ScanSelection(limit=1))):
        out = tmp_path / f"{number}"
        assert run(matched_world, out, dark, selection=first).done
        assert labels_below(out).items() < expected.items()
        assert run(matched_world, out, dark).done
        assert labels_below(out) == expected


@pytest.mark.parametrize(
    ("change", "changed_scans_with_labels"),
    [
        (lambda scan: Scan(scan.points[:3], scan.intensity[:3]), 1),
        (lambda scan: Scan(1000 * scan.points, scan.intensity**3), 0),
    ],
    ids=["three points", "in millimetres"],
)
def test_unusual_scans_leave_the_labels_of_the_others_as_they_are(
    matched_world, tmp_path, change, changed_scans_with_labels
):
    for number in range(2):
        seed = 50 + number
        write_sequence(matched_world.data / "sequences/08", [f"{seed}"], count=4000, seed=seed)
    # A data set with this sequence alone, so that the fit sees no other scans.
    (tmp_path / "one/sequences").mkdir(parents=True)
    (tmp_path / "one/sequences/08").symlink_to(matched_world.data / "sequences/08")
    run(matched_world, selection=ScanSelection(sequences=("08",)), source=tmp_path / "one")
    expected = labels_below(matched_world.out)
    run(
        matched_world,
        tmp_path / "odd",
        copy_scans(matched_world, tmp_path / "data", ["00"], change),
    )
    labels = labels_below(tmp_path / "odd")
    assert expected.items() <= labels.items()
    assert len(expected) == 4
    assert len(labels) == 4 + changed_scans_with_labels


def ring(scan):
    """Return the number of the beam."""
    return np.round(40 * scan.points[:, 2] / np.linalg.norm(scan.points, axis=1))


def simulated(scan):
    """Return the intensity of CARLA, which falls with the range whatever the surface is."""
    return np.exp(-0.004 * np.linalg.norm(scan.points, axis=1))


@pytest.mark.parametrize("values", [ring, simulated])
def test_values_that_are_not_intensities_count_as_none(matched_world, tmp_path, values):
    blind = replace(matched_world, network=replace(matched_world.network, intensity="none"))
    run(blind)
    expected = labels_below(matched_world.out)
    every = copy_scans(matched_world, tmp_path / "a", ["00", "08"], with_intensity(values))
    outcome = run(matched_world, tmp_path / "all", every)
    (warning,) = (w for w in outcome.summary.warnings() if w.code == "no-intensity")
    assert len(warning.scans) == 3
    assert labels_below(tmp_path / "all") == expected
    run(
        matched_world,
        tmp_path / "one",
        copy_scans(matched_world, tmp_path / "b", ["00"], with_intensity(values)),
    )
    name = next(name for name in expected if "00/predictions" in name)
    assert labels_below(tmp_path / "one")[name] == expected[name]


def test_scans_of_another_scale_than_earlier_ones_are_a_warning(matched_world, tmp_path):
    run(matched_world, source=matched_world.data / "sequences/00")
    large = scaled(matched_world, tmp_path / "large", 255)
    outcome = run(matched_world, source=large / "sequences/08")
    (warning,) = (w for w in outcome.summary.warnings() if w.code == "intensity-scale")
    assert warning.scans == ["08/000000", "08/000001"]
    raw = replace(matched_world.network, intensity="raw")
    with pytest.raises(OutputError, match=r"\(intensity\)"):
        predict_scans(matched_world.data / "sequences/00", matched_world.out, settings=raw)


def test_weights_without_the_intensity_of_training(world):
    network = replace(world.network, intensity="match")
    refused(UsageError, "intensity", predict_scans, world.data, world.out, settings=network)
    predict_scans(world.data, world.out, settings=replace(network, intensity="auto"))
    recorded = Manifest(world.out).settings("predict").sensor
    assert recorded.intensity_quantiles == ()


def test_range_images_without_intensity_are_doubted_as_their_scans_are(matched_world, tmp_path):
    dark = scaled(matched_world, tmp_path / "dark", 0.0)
    steps = tmp_path / "steps"
    project_scans(dark, steps, sensor=SMALL)
    outcome = predict_range_images(steps, steps, settings=matched_world.network)
    (warning,) = outcome.summary.warnings()
    assert (warning.code, len(warning.scans)) == ("no-intensity", 3)


def test_the_network_sees_no_gaps(world, tmp_path):
    """Scans of fewer beams, with weights that state the gaps of their training."""
    weights = write_weights(tmp_path / "with-gaps.safetensors", sensor=replace(SMALL, row_gaps=0.1))
    for file in sorted(world.data.rglob("*.bin")):
        scan = read_scan(file)
        rows = project(scan, SMALL).pixel_of_point // SMALL.width
        write_bin(file, scan.take(np.flatnonzero(rows % 2)))
        labels = file.parents[1] / "labels" / f"{file.stem}.label"
        labels.write_bytes(np.fromfile(labels, "<u4")[rows % 2 == 1].tobytes())
    gap_world = replace(world, network=replace(world.network, weights=weights))
    assert run(gap_world).done == 3
    scans = [read_scan(path) for path in sorted(gap_world.data.rglob("*.bin"))]
    images = [project(scan, SMALL) for scan in scans]
    recorded = Manifest(gap_world.out).settings("predict").sensor
    assert recorded.row_gaps == row_gaps(image.channels for image in images) > 0.3
    network = gap_world.network.load()
    space = network.card.space
    for image, content in zip(images, labels_below(gap_world.out).values(), strict=True):
        full = replace(image, channels=fill_rows(image.channels))
        labels = knn_refine(image, network.probabilities(full).argmax(0), space.class_count)
        np.testing.assert_array_equal(np.frombuffer(content, "<u4"), space.to_raw(labels))
