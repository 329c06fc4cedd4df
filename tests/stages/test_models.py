# SPDX-License-Identifier: MIT
import hashlib

from salsanext_cli.stages.models import describe_weights


def test_what_weights_say_of_themselves(weights):
    said = describe_weights(weights)
    assert said["sha256"] == hashlib.sha256(weights.read_bytes()).hexdigest()
    assert said["bytes"] == weights.stat().st_size
    assert said["description"] == "random"
    assert said["architecture"] == {"name": "salsanext", "class_count": 20, "dropout": 0.2}
    assert said["temperature"] == 1
    assert said["label_space"] == "semantic-kitti"
    assert said["classes"][1] == "car"
    assert (said["sensor"]["height"], said["sensor"]["width"]) == (16, 128)
