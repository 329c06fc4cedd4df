# SPDX-License-Identifier: MIT
"""Temporary folders go with the process that made them."""

import os
import subprocess
import sys
import time

from salsanext_cli.io.files.locks import LOCK, PREFIX, STALE_AFTER_S, temporary_folder

KILLED = """
import os, sys
from pathlib import Path
from salsanext_cli.io.files.locks import temporary_folder
with temporary_folder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("x")
    os.kill(os.getpid(), 9)
"""


def test_a_folder_is_gone_after_the_body_and_those_that_others_made_or_hold_stay(tmp_path):
    (tmp_path / "mine").mkdir()
    with temporary_folder(tmp_path) as first:
        (first / "file").write_text("x")
        with temporary_folder(tmp_path) as second:
            assert first != second
        assert (first / "file").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    mine = tmp_path / f"{PREFIX}mine"
    mine.mkdir()
    os.utime(mine, (0, 0))
    with temporary_folder(tmp_path) as held:
        os.utime(held / LOCK, (0, 0))
        with temporary_folder(tmp_path):
            assert mine.exists()
            assert held.exists()


def test_the_folder_of_a_killed_process_goes_with_the_next_one(tmp_path):
    words = [sys.executable, "-c", KILLED, str(tmp_path)]
    assert subprocess.run(words, check=False).returncode == -9
    (half,) = tmp_path.glob(".*/half")
    with temporary_folder(tmp_path):
        assert half.exists()  # Its process may be about to lock it.
    long_ago = time.time() - 2 * STALE_AFTER_S
    os.utime(half.with_name(LOCK), (long_ago, long_ago))
    with temporary_folder(tmp_path) as folder:
        assert [*tmp_path.iterdir()] == [folder]
    assert not [*tmp_path.iterdir()]
