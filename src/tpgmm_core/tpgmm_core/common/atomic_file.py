# SPDX-License-Identifier: Apache-2.0
"""Files that are replaced as a whole: who reads meets the old content or the new one, and nothing between.

Otherwise they are as any program leaves them: a new file has the mode that the umask says, an existing one keeps its
own, and of a link, the file is replaced that it leads to.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any


def write_atomically(path: str | os.PathLike[str], write: Callable[[Path], Any]) -> None:
    """Have a file written beside its place, and put it there only when that succeeded.

    Parameters
    ----------
    path
        the file; its directory must be there
    write
        writes into the file of the name that it is given, which is there already

    Raises
    ------
    OSError
        which names `path`: it is no regular file or must not be written, its directory must not be written or is not
        there, or the disk refuses
    """
    place = Path(os.path.realpath(path))
    try:
        former = _former(place)
        draft = place.with_name(f".{secrets.token_hex(8)}.part")
        # the kernel applies the umask; Python could only ask for it by changing it, for all threads
        os.close(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            write(draft)
            with draft.open("rb+") as file:
                os.fsync(file.fileno())
            if former is not None:
                with contextlib.suppress(PermissionError):  # who may not give a file away owns the new one
                    os.chown(draft, former.st_uid, former.st_gid)
                os.chmod(draft, stat.S_IMODE(former.st_mode))
            os.replace(draft, place)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error  # the class follows from the number


def _former(place: Path) -> os.stat_result | None:
    """What is there now; None where there is nothing. Raises OSError for what must not be replaced."""
    try:
        status = place.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(place))
    if not stat.S_ISREG(status.st_mode):  # a file in its place would be no device any more
        raise OSError(errno.EINVAL, "Not a regular file", str(place))
    if not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, "Permission denied", str(place))
    return status
