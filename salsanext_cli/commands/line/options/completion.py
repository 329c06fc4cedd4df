# SPDX-License-Identifier: MIT
"""Values that a shell completes, by option."""

from collections.abc import Callable, Iterable
from pathlib import Path


def _weights() -> Iterable[str]:
    """Return the default weights and the weights files in the current folder."""
    return "default", *(path.name for path in sorted(Path().glob("*.safetensors")))


def _sensors() -> Iterable[str]:
    """Return the names of the built-in sensors."""
    from salsanext_cli.core.sensors.sensor import presets

    return "auto", *presets()


def _colours() -> Iterable[str]:
    """Return the values of the points by which clouds are coloured."""
    from salsanext_cli.runs.results.folder_names import COLOURS

    return COLOURS


def _classes() -> Iterable[str]:
    """Return the names of the built-in label spaces and those of plug-ins."""
    from salsanext_cli.core.classes.label_space import BUILT_IN
    from salsanext_cli.io.label_spaces import plugged_label_spaces

    return *BUILT_IN, *plugged_label_spaces()


def completer(values: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return the function that typer calls with the beginning of a value."""

    def complete(incomplete: str) -> list[str]:
        return [value for value in values() if value.startswith(incomplete)]

    return complete


COMPLETERS = {
    "--classes": completer(_classes),
    "--colour": completer(_colours),
    "--label-space": completer(_classes),
    "--sensor": completer(_sensors),
    "--weights": completer(_weights),
}
"""Function that completes a value, by the name of the option; shells complete file names."""
