# SPDX-License-Identifier: MIT
"""Label spaces by name or file, and the words by which they can be given again."""

from dataclasses import replace

import pytest
import yaml
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.io.label_spaces import label_space, typed_label_space


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Return the name of a label-space file in the current folder."""
    monkeypatch.chdir(tmp_path)
    data = label_space("coarse").to_dict() | {"name": "mine"}
    (tmp_path / "my classes.yaml").write_text(yaml.safe_dump(data))
    return "my classes.yaml"


def test_a_label_space_has_a_name_or_a_file(file):
    assert label_space("coarse").name == "coarse"
    assert label_space(file).name == "mine"
    assert label_space(file).names == label_space("coarse").names
    refused(UsageError, "coarser", label_space, "coarser")


def test_a_label_space_is_typed_as_in_any_folder(file, tmp_path, monkeypatch):
    typed = typed_label_space(file)
    assert typed == str(tmp_path / file)
    assert typed_label_space("coarse") == "coarse"
    assert typed_label_space(label_space("coarse")) == "coarse"
    monkeypatch.chdir("/")
    assert label_space(typed).name == "mine"


@pytest.mark.parametrize("name", ["coarse", "mine"])
def test_an_object_that_is_not_built_in_cannot_be_typed(name):
    """Another object may have the name of a built-in one."""
    other = replace(label_space("coarse"), name=name, movable_ids=())
    assert typed_label_space(other) is None
    assert typed_label_space(None) is None
