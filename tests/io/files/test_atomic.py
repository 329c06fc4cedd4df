# SPDX-License-Identifier: MIT
"""Files appear complete or not at all, and one process at a time uses a folder."""

import errno
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from scans import refused

from salsanext_cli.core.errors import OutputError
from salsanext_cli.io.files.atomic import (
    append_line,
    foresee_writable,
    require_writable,
    write_bytes,
    write_target,
    writing,
)


def test_file_appears_whole_and_parents_are_made(tmp_path: Path) -> None:
    path = tmp_path / "a b" / "Größe.bin"
    with writing(path) as file:
        file.write(b"half")
        (half,) = path.parent.iterdir()
        assert half.name.startswith(".")
        assert half.suffix == ".part"
        file.write(b" whole")
    assert path.read_bytes() == b"half whole"
    assert list(path.parent.iterdir()) == [path]


def test_permissions_are_the_usual_ones_and_long_names_have_room(tmp_path):
    (tmp_path / "usual").write_bytes(b"")
    write_bytes(tmp_path / "ours", b"")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode
    path = tmp_path / ("n" * 249 + ".label")
    write_bytes(path, b"label")
    assert path.read_bytes() == b"label"


def test_a_folder_at_a_link_to_nothing_cannot_be_written(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "nothing")
    for folder in (link, link / "run"):
        for check in (foresee_writable, require_writable):
            refused(OutputError, folder, check, folder)
    (tmp_path / "nothing").mkdir()
    foresee_writable(link / "run")


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit, ValueError, MemoryError])
def test_interruption_leaves_the_old_file_and_nothing_else(tmp_path, interruption):
    path = tmp_path / "x"
    path.write_bytes(b"old")

    def write() -> None:
        with writing(path) as file:
            file.write(b"new")
            raise interruption

    with pytest.raises(interruption):
        write()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_target_is_replaced_only_if_it_may_be(tmp_path):
    target = tmp_path / "made" / "x"
    write_target(target, b"first", overwrite=False)
    with pytest.raises(OutputError):
        write_target(target, b"second", overwrite=False)
    assert target.read_bytes() == b"first"
    write_target(target, b"second", overwrite=True)
    assert target.read_bytes() == b"second"
    assert list(target.parent.iterdir()) == [target]
    for overwrite in (False, True):
        with pytest.raises(OutputError):
            write_target(tmp_path, b"x", overwrite=overwrite)


def test_file_in_place_of_a_folder_and_folder_in_place_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file" / "x", tmp_path / "file" / "deeper" / "x"):
        with pytest.raises(OutputError, match="cannot be written") as caught:
            write_bytes(path, b"x")
        assert caught.value.subject == str(path)
    (tmp_path / "x").mkdir()
    with pytest.raises(OutputError, match="is a directory"):
        write_bytes(tmp_path / "x", b"x")
    assert {entry.name for entry in tmp_path.iterdir()} == {"file", "x"}


def test_read_only_file_system() -> None:
    # /proc refuses even the superuser.
    if not Path("/proc/self").is_dir():
        pytest.skip("needs /proc")
    with pytest.raises(OutputError) as caught:
        write_bytes(Path("/proc/self/salsanext/x"), b"x")
    assert "permissions" in caught.value.hint


@contextmanager
def full_disk(largest: int) -> Iterator[None]:
    """Refuse files above so many bytes, as a full disk would.

    Not a fixture: pytest writes its own progress, maybe into a larger file, while one is active.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, old)


def test_a_file_or_line_that_does_not_fit_on_the_disk_is_an_error(tmp_path):
    with pytest.raises(OutputError, match="free some space") as caught, full_disk(1000):
        write_bytes(tmp_path / "x", b"x" * 5000)
    assert isinstance(caught.value.__cause__, OSError)
    assert caught.value.__cause__.errno == errno.EFBIG
    assert list(tmp_path.iterdir()) == []
    append_line(tmp_path / "x", b"1" * 600)
    with pytest.raises(OutputError), full_disk(1000):
        append_line(tmp_path / "x", b"2" * 600)
