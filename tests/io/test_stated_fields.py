# SPDX-License-Identifier: MIT
"""A sensor file states its field of view or its mounting, or leaves them to a fit."""

import pytest
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.sensors.sensor import FIELD_OF_VIEW
from salsanext_cli.io.stated_fields import MOUNTING, StatedFields, stated_fields

VALUES = {"up": "[0, 0, 1]", "origin": "[1, 2, 3]", "registered": "true"}


@pytest.mark.parametrize("name", ["auto", "hdl64"])
def test_a_name_states_nothing(name):
    assert stated_fields(name) == StatedFields(view=False, mounting=False)


@pytest.mark.parametrize("key", [*FIELD_OF_VIEW, *MOUNTING, "min_range"])
def test_a_key_of_a_file_states_what_it_belongs_to(key, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f"{key} = {VALUES.get(key, '1')}\n")
    assert stated_fields(path) == StatedFields(view=key in FIELD_OF_VIEW, mounting=key in MOUNTING)


def test_files_that_are_none_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    refused(UsageError, f"sensor {path}", stated_fields, path)
    path.write_text("up = [\n")
    refused(UsageError, path, stated_fields, path)
