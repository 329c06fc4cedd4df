# SPDX-License-Identifier: MIT
"""Sensor files that state a part: the rest is fitted, and printed hints to write one work."""

import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import called, only_json
from scans import SMALL, labels_below, refused, write_bin

from salsanext_cli import Scan, read_scan, sensor
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.wording import spelled
from salsanext_cli.io.stated_fields import StatedFields, stated_fields
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.provenance import Provenance

HEIGHT = 1.7  # Of the sensor above the ground
LIFTED = 1.0  # Distance of the sensor below the origin of its files, too far for a usual height
CENTRAL = (17.0, -17.0)  # Edges of the 85 % of evenly spread elevations that a fit shows
NOT_OF_NEW_WEIGHTS = {"low-confidence", "one-class"}


def seen(count: int = 4000, seed: int = 0) -> Scan:
    """Return points on the ground and on walls around a sensor of a wide field of view."""
    random = np.random.default_rng(seed)
    azimuth = random.uniform(-np.pi, np.pi, count)
    elevation = np.radians(random.uniform(-20, 20, count))
    wall = 12 + 8 * np.sin(3 * azimuth + seed) + random.normal(0, 0.05, count)
    ground = HEIGHT / np.maximum(-np.sin(elevation), 1e-3)
    flat = np.minimum(wall / np.cos(elevation), ground) * np.cos(elevation)
    points = (flat * np.cos(azimuth), flat * np.sin(azimuth), flat * np.tan(elevation))
    return Scan(np.stack(points, axis=1).astype(np.float32), random.random(count, np.float32))


@pytest.fixture
def lifted(tmp_path):
    """Return a folder of scans whose files have their origin above the sensor."""
    for number in range(2):
        scan = seen(seed=number)
        points = scan.points + np.float32([0, 0, LIFTED])
        write_bin(tmp_path / f"lifted/{number}.bin", Scan(points, scan.intensity))
    return tmp_path / "lifted"


@pytest.fixture
def part(tmp_path):
    """Return a file that states the position alone."""
    path = tmp_path / "part.toml"
    path.write_text(f"origin = [0.0, 0.0, {LIFTED}]\n")
    return path


def codes(result):
    found = {warning["code"] for warning in only_json(result)["warnings"]}
    return found - NOT_OF_NEW_WEIGHTS


def lines_of_hint(text):
    """Return what a hint says to write into a file, one setting a line."""
    return "".join(f"{line}\n" for line in re.findall(r"`((?:up|origin) = \[[^]]*\])`", text))


def test_the_hint_about_the_height_works_as_it_is_printed(lifted, weights, tmp_path):
    given = ("--weights", weights, "--engine", "torch", "--json")
    first = called("predict", lifted, tmp_path / "first", *given)
    assert "height" in codes(first)
    (hint,) = [w["hint"] for w in only_json(first)["warnings"] if w["code"] == "height"]
    followed = tmp_path / "followed.toml"
    followed.write_text(lines_of_hint(hint))
    for number, command in enumerate(("predict", "project", "uncertainty --samples 2")):
        name, *options = command.split()
        out = tmp_path / f"followed-{number}"
        engine = () if name == "project" else ("--engine", "torch")
        words = ("--weights", weights, *options, *engine, "--sensor", followed, "--json")
        assert codes(called(name, lifted, out, *words)) == set()
    assert codes(called("inspect", lifted, "--sensor", followed, "--json")) == set()


def test_a_file_with_the_position_alone_gets_the_field_of_view_of_the_scans(lifted, part, weights):
    settings = NetworkSettings(weights, "cpu", engine="torch", sensor=str(part))
    predict_scans(lifted, part.parent / "out", settings=settings)
    used = Provenance(part.parent / "out").sensor()
    placed = replace(settings.named_sensor(), origin=(0.0, 0.0, LIFTED))
    scans = [read_scan(path) for path in sorted(lifted.iterdir())]
    expected = fit_view(scans, placed, mounting=False)
    assert (used.origin, used.up) == ((0, 0, LIFTED), (0, 0, 1))
    assert (used.fov_up, used.fov_down) == (expected.fov_up, expected.fov_down)
    assert (used.fov_up, used.fov_down) == pytest.approx(CENTRAL, abs=0.5)
    assert used.name == "part"


def test_the_same_labels_step_by_step(lifted, part, weights, tmp_path):
    given = ("--weights", weights, "--engine", "torch", "--sensor", part)
    called("predict", lifted, tmp_path / "at-once", *given)
    steps = tmp_path / "steps"
    called("project", lifted, steps, "--weights", weights, "--sensor", part)
    called("predict", steps, steps, *given)
    called("knn-refine", steps)
    assert labels_below(steps) == labels_below(tmp_path / "at-once")


def test_the_file_that_inspect_completes_gives_the_same_sensor(lifted, part, weights, tmp_path):
    whole = tmp_path / "whole.toml"
    called("inspect", lifted, "--sensor", part, "--fit", whole)
    completed = sensor(whole)
    assert completed.origin == (0, 0, LIFTED)
    assert (completed.fov_up, completed.fov_down) == pytest.approx(CENTRAL, abs=0.5)
    given = ("--weights", weights, "--engine", "torch", "--json")
    assert codes(called("predict", lifted, tmp_path / "out", *given, "--sensor", whole)) == set()


def test_earlier_results_do_not_replace_a_stated_position(lifted, part, weights, tmp_path):
    settings = NetworkSettings(weights, "cpu", engine="torch", sensor=str(part))
    out = tmp_path / "out"
    predict_scans(lifted, out, settings=settings)
    part.write_text("origin = [0.0, 0.0, 1.5]\n")
    with refused(OutputError, out / "predict.json") as caught:
        predict_scans(lifted, out, settings=settings)
    assert "origin" in caught.value.problem


@pytest.mark.parametrize(
    ("text", "view", "mounting"),
    [
        ("min_range = 2.0\n", False, False),
        ("origin = [0, 0, 1]\n", False, True),
        ("up = [0, 0, -1]\n", False, True),
        ("registered = true\n", False, True),
        ("fov_up = 3\nfov_down = -25\n", True, False),
        ("fov_up = 3\n", True, False),
    ],
)
def test_what_a_file_lacks_is_fitted(text, view, mounting, weights, tmp_path):
    path = tmp_path / "some.toml"
    path.write_text(text)
    assert stated_fields(path) == StatedFields(view=view, mounting=mounting)
    settings = NetworkSettings(weights, sensor=str(path))
    assert settings.fits_view is not view
    assert settings.fits_mounting is not (view or mounting)
    assert replace(settings, fit=True).fits_mounting
    assert not replace(settings, fit=False).fits_view


def test_names_and_sensors_state_nothing_or_all(weights):
    assert NetworkSettings(weights, sensor="hdl32").fits_mounting
    assert NetworkSettings(weights).fits_mounting
    assert not NetworkSettings(weights, sensor=SMALL).fits_mounting


def test_without_weights_the_hint_completes_the_file(lifted, part, tmp_path, monkeypatch):
    with spelled(CommandLine()), refused(UsageError, part) as caught:
        sensor(part)
    (command,) = re.findall(r"`salsanext (.*?)`", caught.value.hint)
    monkeypatch.chdir(tmp_path)
    called(*command.replace("SCANS", str(lifted)).split())
    assert sensor("NEW.toml").origin == (0, 0, LIFTED)
    half = tmp_path / "half.toml"
    half.write_text("fov_up = 3\n")
    refused(UsageError, half, sensor, half, SMALL)
