"""Archives of ZIP within limits, which are looked at before anything is unpacked."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO
from zipfile import BadZipFile, ZipFile, ZipInfo

MOST_PACKED = 10_000
MOST_BYTES = 512 * 2**20  # unpacked, of all files
_PIECE = 2**20


class Archive:
    """An archive whose number of files and unpacked size are within limits."""

    def __init__(self, file: BinaryIO) -> None:
        try:
            self._archive = ZipFile(file)
        except (BadZipFile, NotImplementedError, ValueError):
            raise ValueError(
                "cannot be read as 3MF, which is an archive of ZIP; it may be cut "
                "short, or another file with this ending"
            ) from None
        entries = self._archive.infolist()
        if len(entries) > MOST_PACKED:
            raise ValueError(
                f"the archive has {len(entries):,} files, and at most {MOST_PACKED:,} "
                "are read; export the stone alone"
            )
        size = sum(entry.file_size for entry in entries)
        if size > MOST_BYTES:
            raise ValueError(
                f"the archive unpacks to {size / 2**20:,.0f} MiB, and at most "
                f"{MOST_BYTES / 2**20:,.0f} MiB are read; export the stone alone, as "
                "a binary STL"
            )
        # Names of parts are compared without regard to case.
        self._entries: dict[str, ZipInfo] = {}
        for entry in entries:
            self._entries[_key(entry.filename)] = entry

    @property
    def names(self) -> list[str]:
        """The names of its files."""
        return [entry.filename for entry in self._entries.values()]

    def __contains__(self, name: str) -> bool:
        return _key(name) in self._entries

    def pieces(self, name: str) -> Iterator[bytes]:
        """Yield the content of a file, never more than its entry says."""
        entry = self._entries[_key(name)]
        if entry.flag_bits & 1:
            raise ValueError(f"{entry.filename} in the archive is encrypted")
        try:
            with self._archive.open(entry) as file:
                while piece := file.read(_PIECE):
                    yield piece
        except (BadZipFile, NotImplementedError, EOFError) as error:
            raise ValueError(
                f"{entry.filename} in the archive is damaged ({error}); export it again"
            ) from None


def _key(name: str) -> str:
    return name.lstrip("/").casefold()
