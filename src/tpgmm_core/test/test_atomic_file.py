# SPDX-License-Identifier: Apache-2.0
"""Files that are replaced as a whole have the mode, the place and the links that any program would leave."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tpgmm_core import TPGMM
from tpgmm_core.common.atomic_file import write_atomically


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def small_model() -> TPGMM:
    data = np.random.default_rng(0).normal(size=(20, 2))
    return TPGMM(n_components=1).fit_projected({"a": data})


def put(path: Path, text: str) -> None:
    write_atomically(path, lambda draft: draft.write_text(text))


@pytest.fixture(params=[0o022, 0o027, 0o002, 0o077], ids=lambda value: f"umask {value:03o}")
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    former = os.umask(request.param)
    yield request.param
    os.umask(former)


def test_a_new_file_has_the_mode_that_the_umask_says(tmp_path: Path, umask: int) -> None:
    put(tmp_path / "file", "new")
    small_model().save(tmp_path / "model.tpgmm")
    assert mode(tmp_path / "file") == mode(tmp_path / "model.tpgmm") == 0o666 & ~umask


@pytest.mark.parametrize("former", [0o600, 0o640, 0o664, 0o666])
def test_an_existing_file_keeps_its_mode(tmp_path: Path, former: int, umask: int) -> None:
    path = tmp_path / "model.tpgmm"
    path.write_text("older")
    path.chmod(former)
    small_model().save(path)
    assert mode(path) == former
    assert TPGMM.load(path).frame_names_ == small_model().frame_names_


def test_a_link_stays_and_leads_to_the_new_content(tmp_path: Path) -> None:
    (tmp_path / "versions").mkdir()
    (tmp_path / "versions" / "2").write_text("older")
    for name, target in (("absolute", tmp_path / "versions" / "2"), ("relative", Path("versions/2"))):
        (tmp_path / name).symlink_to(target)
        put(tmp_path / name, name)
        assert (tmp_path / name).is_symlink() and (tmp_path / "versions" / "2").read_text() == name
    (tmp_path / "dangling").symlink_to("versions/3")
    put(tmp_path / "dangling", "new")
    assert (tmp_path / "versions" / "3").read_text() == "new"


def test_who_reads_meets_the_old_or_the_new_and_a_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "file"
    put(path, "old")

    def fail(draft: Path) -> None:
        draft.write_text("half")
        assert path.read_text() == "old"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, fail)
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["file"]


def test_what_cannot_be_written_is_named_as_it_was_given(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name, reason in (("pipe", "Not a regular file"), ("folder", "Is a directory"), ("no/file", "No such file")):
        with pytest.raises(OSError, match=f"{reason}.*{name}"):
            put(tmp_path / name, "text")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.skipif(os.getuid() != 0, reason="gives up rights that only root has")
def test_a_file_or_folder_that_must_not_be_written_is_left_alone() -> None:
    code = (
        "import os, sys\n"
        "from tpgmm_core.common.atomic_file import write_atomically\n"
        "os.setuid(65534)\n"
        "for name in sys.argv[1:]:\n"
        "    try: write_atomically(name, lambda draft: draft.write_text('new'))\n"
        "    except PermissionError as error: print(error)\n"
    )
    with tempfile.TemporaryDirectory() as folder:  # pytest's own are closed to others
        kept, new = Path(folder) / "kept", Path(folder) / "new"
        kept.write_text("old")
        kept.chmod(0o444)
        os.chmod(folder, 0o755)
        command = [sys.executable, "-c", code, str(kept), str(new)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert ended.stdout.splitlines() == [f"[Errno 13] Permission denied: '{path}'" for path in (kept, new)]
        assert os.listdir(folder) == ["kept"] and kept.read_text() == "old"
