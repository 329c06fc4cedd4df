# SPDX-License-Identifier: MIT
"""Another program writes the target of a stage while the stage works."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from salsanext_cli.core.errors import OutputError

FOREIGN = b"of another program"


@contextmanager
def written_meanwhile(module: ModuleType) -> Iterator[None]:
    """Write a file of another program right after the stage of a module has checked its target."""
    require_target: Callable[..., None] = module.require_target

    def check_then_write(target: Path, *arguments: Any) -> None:
        require_target(target, *arguments)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(FOREIGN)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "require_target", check_then_write)
        yield


def require_kept(module: ModuleType, target: Path, stage: Callable[[bool], object]) -> None:
    """Require that a stage, a function of `overwrite`, replaces a file only if it may.

    `target` must not exist yet.
    """
    with written_meanwhile(module):
        with pytest.raises(OutputError) as caught:
            stage(False)
        assert caught.value.subject == str(target)
        assert target.read_bytes() == FOREIGN
        stage(True)
        assert target.read_bytes() != FOREIGN
