# SPDX-License-Identifier: MIT
import os

import pytest

from salsanext_cli.io.files import user_cache
from salsanext_cli.io.files.user_cache import cached

pytestmark = pytest.mark.usefixtures("own_cache")


def refuse():
    raise AssertionError("made again")


def test_files_are_made_once_and_read_after_that():
    assert cached("a/x.blob", lambda: b"content") == b"content"
    assert cached("a/x.blob", refuse) == b"content"
    with pytest.raises(AssertionError, match="made again"):
        cached("a/y.blob", refuse)


@pytest.mark.parametrize("damaged", [b"", b"content", b"contenT"])
def test_damaged_files_are_made_again(tmp_path, damaged, caplog):
    cached("a/x.blob", lambda: b"content")
    (file,) = tmp_path.rglob("x.blob")
    file.write_bytes(damaged + file.read_bytes()[len(damaged) + 7 :])
    assert cached("a/x.blob", lambda: b"other") == b"other" == cached("a/x.blob", refuse)
    assert "x.blob is damaged" in caplog.text


def test_without_a_writable_folder_files_are_always_made(tmp_path, monkeypatch, caplog):
    (tmp_path / "cache").touch()
    for content in (b"one", b"two"):
        assert cached("a/x.blob", lambda content=content: content) == content
    assert len(caplog.records) == 1
    # Nobody's home, in which no cache folder can be.
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "~")
    assert user_cache.cache_folder() == ""
    assert cached("a/x.blob", lambda: b"three") == b"three"


def test_least_recently_used_files_are_removed_first(tmp_path):
    for number, name in enumerate("abc"):
        cached(f"a/{name}.blob", lambda: bytes(1000))
        os.utime(tmp_path / f"cache/salsanext/a/{name}.blob", (number, number))
    cached("a/a.blob", refuse)
    folder = tmp_path / "cache/salsanext/a"
    user_cache.write_checked(folder / "d.blob", bytes(1000), most_bytes=3500)
    assert sorted(path.stem for path in tmp_path.rglob("*.blob")) == ["a", "c", "d"]
