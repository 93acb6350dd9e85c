"""A disk that knows what was synced, and can lose the rest; that can be full, or broken.

It works on real files, so that what reads them needs no disk. Beside them it keeps what a loss of
power would leave: of each file what was synced, and the changes since; of each folder the names
that were synced, and the changes since. `lose_power` keeps any part of the changes, each whole or
torn, and writes that to the real folder.
"""

import errno
import os
from dataclasses import dataclass, field

from dyknow.journal.disk import Disk


@dataclass
class Contents:
    """Of one file: what is on the disk for sure, and what was done since."""

    synced: bytes = b""
    changes: list = field(default_factory=list)
    """(start, data) of a write, or a size to which it was cut or made longer."""


class SimulatedDisk(Disk):
    """``room``: so many bytes may be allocated yet (None: no end). ``full_writes``: writes fail for
    lack of room, too. ``broken``: what fails with EIO: "sync", "write", "open"."""

    def __init__(self, room=None):
        self.room = room
        self.full_writes = False
        self.broken = set()
        self.calls = 0
        self.stop_after = None
        """The process is killed in the call of this number."""
        self._files = {}
        self._contents = {}
        self._names = {}
        """What each folder has on the disk: path → contents."""
        self._renamings = []
        """(folder, path, contents or None) not synced yet."""

    # -- what the journal calls --------------------------------------------------------------

    def free(self, path):
        return super().free(path) if self.room is None else self.room

    def open(self, path, *, new=False):
        self._call()
        if "open" in self.broken:
            raise OSError(errno.EIO, "input/output error")
        if new and self.room is not None and self.room <= 0:
            raise OSError(errno.ENOSPC, "no space left")
        file = super().open(path, new=new)
        if new:
            self._contents[path] = Contents()
            self._renamings.append((path.parent, path, self._contents[path]))
        self._files[file] = self._of(path)
        return file

    def _of(self, path):
        """What is known of a file. One that was there before this disk was is all on the disk."""
        if path not in self._contents:
            self._names[path] = self._contents[path] = Contents(path.read_bytes())
        return self._contents[path]

    def close(self, file):
        del self._files[file]
        super().close(file)

    def allocate(self, file, start, count):
        self._call()
        if self.room is not None:
            if count > self.room:
                raise OSError(errno.ENOSPC, "no space left")
            self.room -= count
        size = max(os.fstat(file).st_size, start + count)
        os.ftruncate(file, size)
        self._files[file].changes.append(size)

    def write(self, file, data, start):
        self._call(lambda torn: os.pwrite(file, data[:torn], start))
        if self.full_writes:
            os.pwrite(file, data[: len(data) // 2], start)
            raise OSError(errno.ENOSPC, "no space left")
        if "write" in self.broken:
            raise OSError(errno.EIO, "input/output error")
        super().write(file, data, start)
        self._files[file].changes.append((start, bytes(data)))

    def cut(self, file, size):
        self._call()
        super().cut(file, size)
        self._files[file].changes.append(size)

    def sync(self, file):
        self._call()
        if "sync" in self.broken:
            raise OSError(errno.EIO, "input/output error")
        contents = self._files[file]
        contents.synced = os.pread(file, os.fstat(file).st_size, 0)
        contents.changes.clear()

    def sync_folder(self, path):
        self._call()
        if "sync" in self.broken:
            raise OSError(errno.EIO, "input/output error")
        kept = []
        for folder, name, contents in self._renamings:
            if folder == path:
                self._set(name, contents)
            else:
                kept.append((folder, name, contents))
        self._renamings = kept

    def make_folder(self, path):
        path.mkdir(parents=True, exist_ok=True)

    def rename(self, path, target):
        self._call()
        contents = self._of(path)
        super().rename(path, target)
        del self._contents[path]
        self._contents[target] = contents
        self._renamings.append((path.parent, target, contents))
        self._renamings.append((path.parent, path, None))

    def remove(self, path):
        self._call()
        self._of(path)
        super().remove(path)
        del self._contents[path]
        self._renamings.append((path.parent, path, None))

    # -- what happens to it ------------------------------------------------------------------

    def kill(self):
        """The process ends: the operating system has all that was written."""
        for file in tuple(self._files):
            self.close(file)

    def lose_power(self, keep, cut):
        """The machine stops. ``keep()`` says whether a change that was not synced is kept, and
        ``cut(n)`` how many of n bytes of it. Gives the disk after it, over the same folder."""
        self.kill()
        names = dict(self._names)
        for _, name, contents in self._renamings:
            if keep():
                names.pop(name, None)
                if contents is not None:
                    names[name] = contents
        for path in {*self._names, *self._contents} | {name for _, name, _ in self._renamings}:
            path.unlink(missing_ok=True)
        for name, contents in names.items():
            name.write_bytes(_left(contents, keep, cut))
        return SimulatedDisk()

    def _set(self, name, contents):
        if contents is None:
            self._names.pop(name, None)
        else:
            self._names[name] = contents

    def _call(self, torn=None):
        self.calls += 1
        if self.stop_after is not None and self.calls > self.stop_after:
            if torn is not None:
                torn(self.calls)
            raise Killed


class Killed(BaseException):
    """The process is gone amid a call of the disk."""


def _left(contents, keep, cut):
    data = bytearray(contents.synced)
    for change in contents.changes:
        if not keep():
            continue
        if isinstance(change, int):
            del data[change:]
            data.extend(bytes(change - len(data)))
            continue
        start, written = change
        count = cut(len(written))
        # Torn at its end or at its beginning: the disk writes in any order.
        start, written = (start, written[:count]) if keep() else (start + count, written[count:])
        data.extend(bytes(max(0, start + len(written) - len(data))))
        data[start : start + len(written)] = written
    return bytes(data)
