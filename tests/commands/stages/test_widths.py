# SPDX-License-Identifier: MIT
"""Option --width: images of other widths, and the parts of the weights that were fitted at each."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, refused, write_bin
from world import World

from salsanext_cli import Scan, load_network, project, read_scan
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import OutputError, UsageError, WeightsError
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.geometry.row_gaps import column_gaps
from salsanext_cli.core.network.card import AccuracyLine, FittedParts
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.fit.range_images import projected_sensor
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.scans.scan_search import find_scans

WIDE, NARROW, UNTRAINED = 128, 64, 96


@pytest.fixture
def mixed(world: World) -> World:
    """Let the weights know two widths, with a temperature for each."""
    own = FittedParts(temperature=2.0)
    card = replace(
        read_card(world.network.path),
        temperature=1.5,
        accuracy=AccuracyLine(1.0, 0.0, 0.1),
        widths=(WIDE, NARROW, 32),
        parts_of_widths={NARROW: own},
    )
    weights = world.out.with_name("mixed.safetensors")
    save_with_card(world.network.path, weights, card)
    return replace(world, network=replace(world.network, weights=weights))


def at(world: World, width: int) -> World:
    return replace(world, network=replace(world.network, width=width))


def labels_by_hand(world: World, width: int) -> np.ndarray:
    """Return the labels of a scan, from its logits in an image of a width."""
    network = load_network(world.network.weights, "cpu", SMALL.resized(width=width), engine="torch")
    scan = read_scan(world.scan())
    named = replace(world.network, width=width)
    network = fit_scans(named, network, sample_of_files(find_scans(world.data), network.sensor))
    image = project(scan, network.sensor)
    train = knn_refine(image, network.logits(image).argmax(axis=0), network.space.class_count)
    return network.space.to_raw(train)


@pytest.mark.parametrize("width", [WIDE, NARROW, UNTRAINED])
def test_labels_are_those_of_images_of_the_width_which_the_record_states(mixed, caplog, width):
    world = at(mixed, width)
    world.predict()
    np.testing.assert_array_equal(world.labels(), labels_by_hand(world, width))
    settings = Manifest(world.out).settings("predict")
    assert settings.sensor.width == width
    assert settings.temperature == {WIDE: 1.5, NARROW: 2.0, UNTRAINED: 1.5}[width]
    assert ("other-images" in caplog.text) == (width == UNTRAINED)
    # The results of another width are of other settings.
    refused(OutputError, world.out / "predict.json", at(world, 32).predict)


def test_old_weights_know_the_width_of_their_sensor(world, caplog):
    assert read_card(world.network.path).trained_widths == (SMALL.width,)
    at(world, SMALL.width).predict()
    assert "other-images" not in caplog.text
    predict_scans(world.data, world.out.with_name("o"), settings=at(world, 64).network)
    assert "other-images" in caplog.text


def test_parts_are_fitted_for_the_width_and_others_stay(mixed, target, caplog):
    before = read_card(mixed.network.path)
    at(mixed, 32).tune("temperature", target)
    card = read_card(target)
    assert card.trained_widths == (WIDE, NARROW, 32)
    assert card.sensor == before.sensor
    assert (card.temperature, card.at_width(NARROW).temperature) == (1.5, 2.0)
    tuned = card.at_width(32).temperature
    assert tuned not in (1.5, 2.0)
    assert card.parts_of_widths.keys() == {NARROW, 32}
    # One width after the other gives back the same file.
    assert card.at_width(32).at_width(NARROW).to_metadata() == card.to_metadata()
    save_with_card(target, target, card.at_width(NARROW))
    assert read_card(target).to_metadata() == card.to_metadata()


def test_parts_of_another_width_are_named(mixed, caplog):
    caplog.set_level(logging.INFO)
    at(mixed, 32).predict()
    expected = f"temperature, estimated accuracy of images of {WIDE} columns"
    assert f"{expected}; not fitted to images of 32 columns" in caplog.text
    assert Manifest(mixed.out).settings("predict").inherited == expected
    assert read_card(mixed.network.path).at_width(NARROW).parts_of_default_width() == ""


def test_a_threshold_holds_for_the_width_that_it_was_chosen_at(mixed, target):
    at(mixed, NARROW).tune("risk", target, at_most=0.9)
    card = read_card(target)
    assert card.risk is None
    assert card.at_width(NARROW).risk is not None
    world = replace(mixed, network=replace(mixed.network, weights=target))

    def label(width):
        out = world.out.with_name(str(width))
        return predict_scans(world.data, out, settings=at(world, width).network, reject="risk")

    assert label(NARROW).rejected_points is not None
    for width in (WIDE, 32):
        error = refused(WeightsError, target, label, width).value
        assert f"{width} columns" in error.problem
    save_with_card(target, target, replace(card, risk=card.at_width(NARROW).risk))
    refused(UsageError, "width", label, UNTRAINED)


def test_projected_images_of_a_width_are_labelled_at_that_width(mixed):
    network = at(mixed, NARROW).network
    sensor = network.named_sensor()
    project_scans(mixed.data, mixed.out, sensor=sensor, fit=True)
    assert projected_sensor(mixed.out).width == NARROW
    wide = at(mixed, WIDE).network
    refused(UsageError, mixed.out, predict_range_images, mixed.out, mixed.out, settings=wide)
    predict_range_images(mixed.out, mixed.out, settings=network)
    assert np.load(mixed.result("pixel_labels")).shape == (SMALL.height, NARROW)


def test_the_uncertainty_is_of_images_of_the_width(mixed):
    few = UncertaintyMethod(samples=2, aleatoric="none")
    uncertainty(mixed.data, mixed.out, settings=at(mixed, NARROW).network, method=few)
    assert Manifest(mixed.out).settings("uncertainty").sensor.width == NARROW


@pytest.mark.parametrize("width", [0, 15, 1 << 18])
def test_an_impossible_width_is_refused(world, width):
    refused(UsageError, "width", at(world, width).predict)


@pytest.mark.parametrize("change", [{"widths": [64]}, {"widths": "128"}, {"widths": [128, 128]}])
def test_damaged_widths_are_refused(world, change):
    metadata = json.loads(read_card(world.network.path).to_metadata()["salsanext"]) | change
    with pytest.raises(WeightsError, match="damaged"):
        type(read_card(world.network.path)).from_metadata({"salsanext": json.dumps(metadata)}, "w")


def every_second_column(world: World) -> None:
    """Write scans with a point in every pixel of the wide image, but of even columns only."""
    v, u = np.mgrid[: SMALL.height, 0:WIDE:2].reshape(2, -1)
    elevation = np.radians(3.0 - 28.0 * (v + 0.5) / SMALL.height)
    azimuth = np.pi * (1 - 2 * (u + 0.5) / WIDE)
    flat = 10 * np.cos(elevation)
    points = [flat * np.cos(azimuth), flat * np.sin(azimuth), 10 * np.sin(elevation)]
    scan = Scan(np.stack(points, axis=1).astype(np.float32), np.full(len(u), 0.5, np.float32))
    for file in find_scans(world.data):
        write_bin(file.path, scan)


def test_images_are_as_narrow_as_the_sensor_unless_a_width_is_named(mixed, caplog):
    caplog.set_level(logging.INFO)
    every_second_column(mixed)
    mixed.predict()
    settings = Manifest(mixed.out).settings("predict")
    assert (settings.sensor.width, settings.temperature) == (NARROW, 2.0)
    assert f"in images of {WIDE} columns: {NARROW} columns replace them" in caplog.text
    lines = [record.getMessage() for record in caplog.records]
    assert [line for line in lines if line.startswith("50 % of the pixels between columns")]
    # The fit to the narrower images repeats no line.
    assert sum("own vehicle not searched for" in line for line in lines) == 1
    assert len(set(lines)) == len(lines)
    np.testing.assert_array_equal(mixed.labels(), labels_by_hand(mixed, NARROW))
    # The run can be continued.
    caplog.clear()
    assert predict_scans(mixed.data, mixed.out, settings=mixed.network).skipped == 3
    wide = at(mixed, WIDE)
    predict_scans(mixed.data, mixed.out.with_name("wide"), settings=wide.network)
    assert f"use width={NARROW}" in caplog.text
    assert Manifest(mixed.out.with_name("wide")).settings("predict").sensor.width == WIDE


def test_a_threshold_of_a_wider_image_does_not_hold_for_narrower_ones(mixed, target):
    at(mixed, WIDE).tune("risk", target, at_most=0.9)
    world = replace(mixed, network=replace(mixed.network, weights=target))
    every_second_column(world)
    error = refused(
        WeightsError,
        target,
        predict_scans,
        world.data,
        world.out,
        settings=world.network,
        reject="risk",
    ).value
    assert f"{NARROW} columns" in error.problem


def test_gaps_between_columns_are_those_between_rows_of_the_turned_image():
    image = np.zeros((5, 3, 20), np.float32)
    image[0, 0, [0, 2, 3, 11]] = 1  # One gap of a pixel; seven are no gap.
    image[0, 2, [5, 12]] = 1  # Six
    assert column_gaps([image]) == round(7 / 13, 4)
