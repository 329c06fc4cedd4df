# SPDX-License-Identifier: MIT
"""The labelling tools that `pick` writes for, and `import-labels` reads."""

from collections.abc import Mapping
from pathlib import Path

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import did_you_mean
from salsanext_cli.core.wording import argument
from salsanext_cli.io.annotation_tools.point_labeler import PointLabeler
from salsanext_cli.io.annotation_tools.segments import Segments
from salsanext_cli.io.annotation_tools.sse import SemanticSegmentationEditor
from salsanext_cli.io.annotation_tools.supervisely import Supervisely
from salsanext_cli.io.annotation_tools.tool import AnnotationTool

TOOLS: Mapping[str, AnnotationTool] = {
    tool.name: tool
    for tool in (PointLabeler(), Segments(), SemanticSegmentationEditor(), Supervisely())
}
"""Tools by name."""


def tool_named(name: str) -> AnnotationTool:
    """Return a tool by name; an unknown name raises `UsageError`."""
    if name not in TOOLS:
        expected = f"one of {', '.join(TOOLS)}"
        hint = did_you_mean(name, TOOLS)
        raise UsageError(f"{argument('tool')} {name}", "no such labelling tool", expected, hint)
    return TOOLS[name]


def tool_of(path: Path) -> AnnotationTool | None:
    """Return the tool that recognises a file with labels; None for none."""
    return next((tool for tool in TOOLS.values() if tool.recognises(path)), None)


def lacks_labels(path: Path) -> bool:
    """Return whether a point cloud is of a tool that has its labels in another file."""
    return any(tool.lacks_labels(path) for tool in TOOLS.values())
