# SPDX-License-Identifier: MIT
"""Label spaces by name: built-in ones, YAML files and plug-ins."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from salsanext_cli.core.classes.label_space import BUILT_IN, KEYS, LabelSpace, built_in
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.plug_ins import PlugIn, load_plug_ins
from salsanext_cli.core.texts import did_you_mean
from salsanext_cli.io.files.yaml_toml import read_yaml


@cache
def plugged_label_spaces() -> dict[str, PlugIn]:
    """Return the label spaces of plug-ins by name."""
    return load_plug_ins("label_spaces", BUILT_IN, LabelSpace)


def label_space(name_or_file: str | Path = "semantic-kitti") -> LabelSpace:
    """Return a label space by name or file.

    Parameters
    ----------
    name_or_file : str or Path
        Built-in label space, YAML file in the form of SemanticKITTI, or plug-in.

    Returns
    -------
    LabelSpace

    Raises
    ------
    UsageError
        If there is no such name or file, or the file is invalid.
    """
    if str(name_or_file) in BUILT_IN:
        return built_in(str(name_or_file))
    path = Path(name_or_file)
    try:
        data = read_yaml(path, "a yaml file in the form of SemanticKITTI")
    except FileNotFoundError as error:
        plug_ins = plugged_label_spaces()
        if str(name_or_file) in plug_ins:
            target: LabelSpace = plug_ins[str(name_or_file)].target
            return target
        names = ", ".join(list(BUILT_IN) + [str(plug_in) for plug_in in plug_ins.values()])
        hint = did_you_mean(str(path), [*BUILT_IN, *plug_ins])
        raise UsageError(path, "no such file", f"a .yaml file or one of {names}", hint) from error
    if not isinstance(data, dict):
        expected = f"a mapping with the keys {', '.join(KEYS)}"
        raise UsageError(path, f"contains a {type(data).__name__}", expected)
    return LabelSpace.from_dict(data, path)


def typed_label_space(space: LabelSpace | str | None) -> str | None:
    """Return the name or the absolute path by which a label space can be given again.

    Parameters
    ----------
    space : LabelSpace or str, optional
        A label space, or its name or file.

    Returns
    -------
    str or None
        None for no label space, and for one that is neither built-in nor named.
    """
    if space is None:
        return None
    if isinstance(space, LabelSpace):
        is_built_in = space.name in BUILT_IN and space is built_in(space.name)
        return space.name if is_built_in else None
    is_file = space not in BUILT_IN and Path(space).exists()
    return str(Path(space).absolute()) if is_file else space
