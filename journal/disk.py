"""The few calls by which the journal reaches the disk: tests put a failing one in their place."""

from __future__ import annotations

import os
from pathlib import Path


class Disk:
    """Files and folders of the operating system. Raises ``OSError`` as it does."""

    def open(self, path: Path, *, new: bool = False) -> int:
        """A descriptor to read and write; a new file must not be there yet."""
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT | os.O_EXCL if new else 0)
        return os.open(path, flags, 0o600)

    def close(self, file: int) -> None:
        os.close(file)

    def allocate(self, file: int, start: int, count: int) -> None:
        """Make room for ``count`` bytes from ``start`` on: zeros, that a later write cannot fail
        to replace for lack of room."""
        os.posix_fallocate(file, start, count)

    def write(self, file: int, data: bytes, start: int) -> None:
        """Write all of ``data`` at ``start``."""
        view = memoryview(data)
        while view:
            count = os.pwrite(file, view, start)
            view, start = view[count:], start + count

    def cut(self, file: int, size: int) -> None:
        """Let the file end after ``size`` bytes."""
        os.ftruncate(file, size)

    def sync(self, file: int) -> None:
        """Return when what was written is on the disk, as far as it tells the truth."""
        os.fdatasync(file)

    def sync_folder(self, path: Path) -> None:
        """The same of the names in a folder."""
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def free(self, path: Path) -> int:
        """Bytes that there is room for where ``path`` is."""
        found = os.statvfs(path)
        return found.f_bavail * found.f_frsize

    def make_folder(self, path: Path) -> None:
        """See to it that the folder is there, on the disk, too; and those that it is in."""
        missing = [each for each in (path, *path.parents) if not each.is_dir()]
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        for each in reversed(missing):
            self.sync_folder(each.parent)

    def rename(self, path: Path, target: Path) -> None:
        os.replace(path, target)

    def remove(self, path: Path) -> None:
        path.unlink()


DISK = Disk()
