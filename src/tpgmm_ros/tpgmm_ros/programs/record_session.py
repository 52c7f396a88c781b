# SPDX-License-Identifier: Apache-2.0
"""`RecordSession`: one demonstration after the other, started, stopped and taken back; and what is said of them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tpgmm_ros.messages.sources import TransformSource
from tpgmm_ros.nodes.frame_watch import FrameWatch, Seen
from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.recordings.recorded_topics import ROBOT_DESCRIPTION, needed_topics
from tpgmm_ros.recordings.storage.bag_writer import UNDONE, free_name
from tpgmm_ros.task.task_file import Task


@dataclass(frozen=True, slots=True)
class Recorded:
    """A demonstration that was recorded.

    Attributes
    ----------
    bag
        where it is
    duration_s
        from the first to the last message, s
    messages
        by topic
    missing
        topics that the task needs, and frames, of which nothing came
    """

    bag: Path
    duration_s: float
    messages: dict[str, int]
    missing: tuple[str, ...]

    def __str__(self) -> str:
        came = ", ".join(f"{topic} {count}" for topic, count in self.messages.items() if count)
        lost = f"; MISSING: {', '.join(self.missing)}" if self.missing else ""
        return f"{self.bag}: {self.duration_s:.1f} s, {came or 'no message'}{lost}"


class RecordSession:
    """Demonstrations into one folder.

    Parameters
    ----------
    recorder
        records
    watch
        sees the frames
    folder
        of the bags
    task
        what is demonstrated
    said
        called with what happened, in words
    """

    def __init__(
        self, recorder: BagRecorder, watch: FrameWatch, folder: Path, task: Task, said: Callable[[str], None]
    ) -> None:
        self._recorder, self._watch, self._folder, self._task, self._said = recorder, watch, folder, task, said
        self._needed = list(needed_topics(task))
        self._before: dict[str, Seen] = {}
        self.done: list[Recorded] = []

    def start(self) -> str:
        """Begin a demonstration; returns what happened. Raises ValueError and OSError as the recorder does."""
        self._before = {frame.name: frame for frame in self._watch.frames()}
        return self._tell(f"recording {self._recorder.start(self._folder)}")

    def stop(self) -> str:
        """End it and keep it; returns what happened. Raises ValueError and OSError as the recorder does."""
        duration, counts = self._recorder.duration_s, self._recorder.counts
        bag = self._recorder.stop()
        lost = [topic for topic in self._needed if not counts[topic] and not topic.endswith("tf_static")]
        for frame in self._watch.frames():
            if self._is_missing(frame) and frame.count == self._before[frame.name].count:
                lost.append(f"frame {frame.name}" + (f" ({frame.trouble})" if frame.trouble else ""))
        self.done.append(Recorded(bag, duration, counts, tuple(lost)))
        if len(self.done) == 1 and not counts[ROBOT_DESCRIPTION]:
            self._said(
                "nobody publishes robot_description, so Foxglove and rerun will not draw the robot from these bags: "
                "start a robot_state_publisher, or endpoint_poses with broadcast_transforms:=true"
            )
        return self._tell(str(self.done[-1]))

    def _is_missing(self, frame: Seen) -> bool:
        """Whether nothing says where a frame is; of a pose that was published once, the recorder alone knows."""
        source = self._task.sources[frame.name]
        published_once = (
            not isinstance(source, TransformSource)
            and not (source.selection or frame.trouble or frame.count)
            and self._recorder.came[source.topic] > 0
        )
        return frame.missing and not published_once

    def undo(self) -> str:
        """Take back the demonstration that is being recorded, else the last one, which is put aside.

        Returns
        -------
        str
            what happened

        Raises
        ------
        ValueError
            there is none.
        OSError
            it cannot be moved.
        """
        if self._recorder.recording is not None:
            return self._tell(f"discarded {self._recorder.discard()}")
        if not self.done:
            raise ValueError("there is nothing to undo: no demonstration was recorded since this program began")
        last = self.done[-1].bag
        aside = last.parent / UNDONE / last.name
        aside.parent.mkdir(exist_ok=True)
        aside = last.rename(free_name(aside))
        self.done.pop()
        return self._tell(f"undone {last}: it is in {aside}")

    def toggle(self) -> str:
        """Start where nothing is recorded, else stop; returns what happened."""
        return self.start() if self._recorder.recording is None else self.stop()

    def end(self) -> None:
        """Keep what is being recorded, if anything is; raises OSError where the disk does not take it."""
        if self._recorder.recording is not None:
            self.stop()

    def line(self) -> str:
        """What is recorded, and how often what comes, in one line."""
        recording = self._recorder.recording
        head = f"{recording.name} {self._recorder.duration_s:6.1f} s" if recording else "ready"
        lost = [f"{frame.name} MISSING" for frame in self._watch.frames() if self._is_missing(frame)]
        rates = [f"{topic} {_hertz(rate)}" for topic, rate in self._recorder.rates().items() if topic in self._needed]
        return " | ".join([head, *(lost or ["all frames seen"]), *rates])  # what counts most is not cut off

    def _tell(self, text: str) -> str:
        self._said(text)
        return text


def _hertz(rate: float | None) -> str:
    return "-" if rate is None else f"{rate:.0f} Hz"


def answered(act: Callable[[], str]) -> tuple[bool, str]:
    """Whether something succeeded, and what happened or why not, in words."""
    with contextlib.suppress(KeyboardInterrupt):
        try:
            return True, act()
        except (ValueError, OSError) as error:
            return False, str(error)
    return False, "interrupted"
