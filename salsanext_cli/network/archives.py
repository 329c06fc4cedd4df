# SPDX-License-Identifier: MIT
"""The archives that `torch.save` writes, checked before torch unpacks them."""

from __future__ import annotations

from typing import BinaryIO
from zipfile import ZIP_STORED, BadZipFile, ZipFile


def require_stored(archive: ZipFile, file: BinaryIO) -> None:
    """Raise `BadZipFile` if an archive holds less than it unpacks to; torch never compresses.

    Parameters
    ----------
    archive : ZipFile
        Opened on `file`.
    file : BinaryIO
        The file itself.
    """
    members = archive.infolist()
    size = file.seek(0, 2)
    if (
        any(m.compress_type != ZIP_STORED for m in members)
        or sum(m.file_size for m in members) > size
    ):
        raise BadZipFile("it would unpack to more than it holds")
