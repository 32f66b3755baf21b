"""A file that grows by whole pieces or not at all."""

import errno
import os
from pathlib import Path

from .log_format import LogError


class AppendFile:
    """A new file; every `append` stands in it entirely, or it is as before.

    Args:
        path: The file; its folder is made if it does not exist.
        overwrite: Whether an existing file may be replaced.
        quota: Size it may reach [bytes]; None for no limit.

    Raises:
        LogError: it exists, or cannot be made.
    """

    def __init__(self, path: Path, overwrite: bool, quota: int | None) -> None:
        self.size = 0
        """Bytes in the file."""
        self.quota = quota
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | (os.O_TRUNC if overwrite else os.O_EXCL)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, flags, 0o644)
        except OSError as error:
            if path.exists() and not overwrite:
                raise LogError(f"{path}: exists already; choose another name or overwrite it") from None
            raise LogError(f"{path}: cannot be written: {error.strerror}") from None

    def append(self, data: bytes) -> None:
        """Write all of `data`, or nothing.

        Raises:
            OSError: there is no room, or the quota would be passed.
        """
        try:
            if self.quota is not None and self.size + len(data) > self.quota:
                raise OSError(errno.EDQUOT, f"the quota of {self.quota} bytes is reached")
            view = memoryview(data)
            while view:
                view = view[os.write(self._file, view) :]
        except OSError:
            self.cut(self.size)
            raise
        self.size += len(data)

    def cut(self, size: int) -> None:
        """Take back what is beyond a size."""
        os.ftruncate(self._file, size)
        os.lseek(self._file, size, os.SEEK_SET)
        self.size = size

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)
