# SPDX-License-Identifier: MIT
"""Settings that a threshold of risk records are those that labels depend on."""

from dataclasses import replace

import pytest
from scans import SMALL, write_weights

from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.runs.fit.threshold_settings import label_settings, setting_as_typed
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.sensor_request import requested_sensor


@pytest.fixture(scope="module")
def narrow_file(tmp_path_factory):
    """Return weights of few channels."""
    from narrow_network import narrow_salsanext

    with narrow_salsanext():
        yield write_weights(tmp_path_factory.mktemp("narrow") / "w.safetensors", sensor=SMALL)


def test_labels_depend_on_what_is_requested_and_on_nothing_else(narrow_file):
    settings = NetworkSettings(narrow_file, "cpu", engine="torch")
    network = settings.load()
    before = label_settings(settings, network)
    assert before.keys() <= {*KEY_OF.values()}
    assert label_settings(replace(settings, columns="x,y,z"), network) == before
    for change in ({"min_range": 2.0}, {"ego": "none"}, {"width": 128}, {"intensity": "raw"}):
        (name,) = change
        after = label_settings(replace(settings, **change), network)
        differing = {
            key for key in before.keys() | after.keys() if before.get(key) != after.get(key)
        }
        assert differing <= {KEY_OF[name]}, name


@pytest.mark.parametrize("text", ["auto", "none", "-1,-1,-2,1,1,0.5"])
def test_a_box_is_typed_as_it_is_read(text):
    sensor = requested_sensor("auto", lambda: SMALL, ego=text, min_range=0.0)
    assert setting_as_typed("ego", sensor.ego_box) == text


@pytest.mark.parametrize(
    ("argument", "value", "text"),
    [
        ("min_range", 1.50, "1.5"),
        ("min_range", None, "the default"),
        ("intensity", None, "raw"),
        ("intensity", "match", "match"),
        ("precision", "int8", "int8"),
        ("width", 512, "512"),
    ],
)
def test_values_are_typed_for_their_arguments(argument, value, text):
    assert setting_as_typed(argument, value) == text
