# SPDX-License-Identifier: Apache-2.0
"""`convert`: LeRobot datasets become bags and bags a dataset, with the same numbers; damaged ones are refused."""

from __future__ import annotations

import json
import pickle
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conversions_made import run
from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_ros.programs import convert
from tpgmm_ros.recordings.bags import find_bags, read_recording
from tpgmm_ros.task.task_file import Task

pa: Any = pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'pyarrow>=21'")
pq: Any = pytest.importorskip("pyarrow.parquet")

BACK = ["--movement", "observation.state", "--frame", "object=observation.environment_state[0:7]"]
DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three bags at 10 Hz, and the dataset of them; in the second one the object is seen from sample 20 on."""
    folder = tmp_path_factory.mktemp("lerobot")
    (folder / "task.yaml").write_text(REACH_TASK)
    for i in range(3):
        topics = reach(i, samples=41 + i, duration=4.0 + 0.1 * i)
        if i == 1:
            seen = topics["/object/pose"]
            topics["/object/pose"] = replace(seen, poses=seen.poses[20:], recorded=seen.recorded[20:])
        write_bag(folder / "bags" / f"demo_{i}", topics)
    options = ["--lerobot", "--task", str(folder / "task.yaml"), "--to", str(folder / "dataset")]
    assert convert.main([*options, str(folder / "bags")]) == 0
    return folder


def test_bags_to_a_dataset_and_back_are_the_same_bit_by_bit(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = run(capsys, "--to", tmp_path / "back", *BACK, made / "dataset")
    assert [(bag["samples"], bag["rate_hz"]) for bag in found["bags"]] == [
        (41 + i, pytest.approx(10)) for i in range(3)
    ]
    assert found["bags"][0]["notes"] == ["task: reach"]
    task, again = Task.load(made / "task.yaml"), Task.load(tmp_path / "back" / "task.yaml")
    for i, path in enumerate(find_bags([tmp_path / "back"])):
        first, second = read_recording(made / "bags" / f"demo_{i}", task), read_recording(path, again)
        np.testing.assert_array_equal(first.movement, second.movement)
        np.testing.assert_array_equal(np.round(first.times, 9), np.round(second.times, 9))
        np.testing.assert_array_equal(first.visible["object"], second.visible["object"])
        seen = first.visible["object"]
        np.testing.assert_array_equal(first.frames["object"][seen], second.frames["object"][seen])
    assert not read_recording(made / "bags" / "demo_1", task).visible["object"][:20].any()


def test_the_dataset_is_laid_out_as_lerobot_reads_it(made: Path) -> None:
    folder = made / "dataset"
    info = json.loads((folder / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == 10 and info["total_frames"] == 41 + 42 + 43
    data = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(data.column_names) == set(info["features"])
    for name, feature in info["features"].items():
        kind = data.schema.field(name).type
        size = 1 if not pa.types.is_fixed_size_list(kind) else kind.list_size
        assert [size] == feature["shape"] and len(feature["names"] or "?" * size) == size
    episodes = pq.read_table(folder / EPISODES).to_pylist()
    assert [(row["dataset_from_index"], row["length"]) for row in episodes] == [(0, 41), (41, 42), (83, 43)]
    state = np.array(data["observation.state"].to_pylist())[41:83]
    np.testing.assert_allclose(episodes[1]["stats/observation.state/mean"], state.mean(axis=0))
    np.testing.assert_array_equal(np.array(data["action"].to_pylist())[41:82], state[1:])
    assert json.loads((folder / "meta" / "stats.json").read_text())["observation.state"]["count"] == [126]
    tasks = pq.read_table(folder / "meta" / "tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": "reach"}]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_another_rate_says_how_far_it_leads_away(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--lerobot", "--task", made / "task.yaml", "--to", tmp_path / "slow", "--rate", "4"]
    found = run(capsys, *options, made / "bags" / "demo_0")
    assert found["rate_hz"] == 4 and found["bags"][0]["samples"] == 17
    assert "41 samples became 17 at 4 Hz, at most" in found["bags"][0]["notes"][-1]
    assert "exists, and is not overwritten" in run(capsys, *options, made / "bags" / "demo_0")["error"]
    assert "a whole number" in run(capsys, *options[:-2], "--rate", "4.5", made / "bags" / "demo_0")["error"]


def test_single_numbers_of_a_feature_have_names(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    xyz = ",".join(f"observation.state.{name}" for name in "xyz")
    found = run(capsys, "--to", tmp_path / "a", "--movement", xyz, made / "dataset")
    assert found["passed"] and len(found["bags"]) == 3
    for movement, words in (("state", "has no feature 'state'; there are"), ("camera", "is of video (480, 640, 3)")):
        copy = tmp_path / movement
        shutil.copytree(made / "dataset", copy)
        change(copy, lambda info: info["features"].update(camera={"dtype": "video", "shape": [480, 640, 3]}))
        assert words in run(capsys, "--to", tmp_path / "b", "--movement", movement, copy)["error"]


def test_without_pyarrow_it_is_said_what_to_install(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.delitem(sys.modules, "pyarrow.parquet")
    for arguments in ([*BACK, made / "dataset"], ["--lerobot", "--task", made / "task.yaml", made / "bags"]):
        found = run(capsys, "--to", tmp_path / "out", *arguments)
        assert "need pyarrow" in found["error"] and "pip install 'pyarrow>=21'" in found["error"]
        assert not (tmp_path / "out").exists()


# -- damaged and hostile datasets


def change(folder: Path, how: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "meta" / "info.json"
    info = json.loads(path.read_text())
    how(info)
    path.write_text(json.dumps(info))


def told(**what: object) -> Callable[[Path], None]:
    return lambda folder: change(folder, lambda info: info.update(what))


def written(name: str, content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(content)


def cut(name: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-100])


def column(file: str, name: str, how: Callable[[list[Any]], Any]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        table = pq.read_table(folder / file)
        values = how(table[name].to_pylist())
        pq.write_table(table.set_column(table.column_names.index(name), name, pa.array(values)), folder / file)

    return damage


def many_rows(folder: Path) -> None:
    """A file of some kB that holds 20 million rows."""
    names = pq.read_schema(folder / DATA).names
    pq.write_table(pa.table(dict.fromkeys(names, pa.repeat(0, 20_000_000))), folder / DATA, compression="zstd")


def long_lists(folder: Path) -> None:
    """Samples of a million numbers each, all the same."""
    column(DATA, "observation.state", lambda values: [[0.0] * 100_000] * len(values))(folder)


DAMAGES: list[tuple[Callable[[Path], object], str]] = [
    (cut("meta/info.json"), "info.json: is damaged"),
    (written("meta/info.json", b"[" * 100_000), "info.json: is damaged"),
    (written("meta/info.json", b"[]"), "is of the version None, expected v3.0"),
    (
        told(codebase_version="v2.1"),
        "'v2.1', expected v3.0; LeRobot's own convert_dataset_v21_to_v30",
    ),
    (told(fps=0), "info.json: cannot be understood: fps is 0.0"),
    (told(fps=float("nan")), "fps is nan"),
    (told(fps="{0.__class__}"), "info.json: cannot be understood"),
    (told(total_frames=10**12), "total_frames is 1000000000000"),
    (told(total_frames=127), "announces 127 samples, meta/episodes 126"),
    (told(total_episodes=4), "announces 4 rows of meta/episodes, and 3 are there"),
    (told(features=[]), "info.json: cannot be understood"),
    (told(features={}), "lacks the features timestamp"),
    (lambda folder: change(folder, lambda info: info.pop("fps")), "info.json: lacks 'fps'"),
    (
        written(DATA, b"version https://git-lfs.github.com/spec/v1\n"),
        "is a pointer of Git LFS, no data: run 'git lfs pull'",
    ),
    (cut(DATA), "file-000.parquet: cannot be read"),
    (cut(EPISODES), "file-000.parquet: cannot be read"),
    (written(DATA, pickle.dumps([1, 2])), "file-000.parquet: cannot be read"),
    (lambda folder: shutil.rmtree(folder / "meta" / "episodes"), "has no files meta/episodes/*/*.parquet"),
    (lambda folder: shutil.rmtree(folder / "data"), "has no files data/*/*.parquet"),
    (many_rows, "announces 126 rows of data, and more are there"),
    (long_lists, "observation.state holds other samples than of 7 numbers"),
    (column(DATA, "observation.state", lambda v: [one[:6] for one in v]), "samples that are not of 7 numbers"),
    (column(DATA, "observation.state", lambda v: [["a"] * 7] * len(v)), "is of string, expected numbers"),
    (column(DATA, "frame_index", lambda v: [*v[1:], v[0]]), "not in order: frame_index leaps"),
    (column(DATA, "episode_index", lambda v: [9] * len(v)), "announces 41 samples of episode 0, data holds 0"),
    (column(EPISODES, "episode_index", lambda v: [0] * len(v)), "announces episode 0 twice"),
    (column(EPISODES, "length", lambda v: [42, 41, 43]), "announces 42 samples of episode 0, data holds 41"),
]


@pytest.mark.parametrize(("damage", "words"), DAMAGES, ids=[words[-40:] for _, words in DAMAGES])
def test_what_is_damaged_is_refused_in_words(
    damage: Callable[[Path], object], words: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(made / "dataset", tmp_path / "dataset")
    damage(tmp_path / "dataset")
    found = run(capsys, "--to", tmp_path / "bags", *BACK, tmp_path / "dataset")
    assert words in found["error"] and found["error"].count(str(tmp_path / "dataset")) == 1
    assert not (tmp_path / "bags").exists()


def test_timestamps_that_do_not_fit_the_rate_are_used_and_said(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(made / "dataset", tmp_path / "dataset")
    column(DATA, "timestamp", lambda v: [2.0 * t for t in v])(tmp_path / "dataset")
    found = run(capsys, "--to", tmp_path / "bags", *BACK, tmp_path / "dataset")
    assert found["bags"][0]["rate_hz"] == pytest.approx(5.0, rel=1e-4)
    assert "timestamps are up to 4.0000 s away from 10 Hz" in found["bags"][0]["notes"][1]


class Touch:
    """Makes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_no_pickle_in_a_schema_is_loaded(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(made / "dataset", tmp_path / "dataset")
    table = pq.read_table(tmp_path / "dataset" / DATA)
    trap = {
        "ARROW:extension:name": "arrow.py_extension_type",
        "ARROW:extension:metadata": pickle.dumps(Touch(tmp_path / "loaded")),
    }
    schema = pa.schema([field.with_metadata(trap) for field in table.schema])
    pq.write_table(table.cast(schema), tmp_path / "dataset" / DATA)
    run(capsys, "--to", tmp_path / "bags", *BACK, tmp_path / "dataset")
    assert not (tmp_path / "loaded").exists()
    pickle.loads(pickle.dumps(Touch(tmp_path / "loaded")))
    assert (tmp_path / "loaded").exists()
