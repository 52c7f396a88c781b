# SPDX-License-Identifier: Apache-2.0
"""The part `movements` of a task file: end points that move together, each seen from the others as from any frame.

movements:
  left: {topic: endpoint/left/pose}                      # end point → topic of its pose, a PoseStamped
  right: {topic: endpoint/right/pose, frames: [left]}    # optional: from which frames and end points it is seen

It takes the place of `movement` and `endpoint`. Behind the path of such a file stands which movement is meant:
carry.yaml#left. That is a task as any other one, whose frames are those of the file and the other end points.
"""

from __future__ import annotations

from pathlib import Path

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_topic, is_name, some_names

OF = "#"
"""Between the path of a task file and the movement that is meant."""


def divided_path(path: str | Path) -> tuple[Path, str | None]:
    """The file, and the movement that is meant: carry.yaml#left; None for a path that names none, or is a file itself.

    Parameters
    ----------
    path
        as people give it

    Returns
    -------
    tuple[Path, str | None]
        file and movement
    """
    file, mark, movement = str(path).rpartition(OF)
    return (Path(path), None) if not mark or Path(path).exists() else (Path(file), movement)


def movement_of(top: Section, movement: str | None) -> Section:
    """The task of one movement, as a task file of that movement alone would say it.

    Parameters
    ----------
    top
        the whole file
    movement
        which of its movements; None: it has one only

    Returns
    -------
    Section
        without the part `movements`

    Raises
    ------
    YamlError
        the file has no such movement, or several and none is named, or the part does not describe movements
    """
    if "movements" not in top.values:
        if movement is not None:
            raise top.error(f"has one movement only: give its path without {shown(OF + movement)}")
        return top
    if other := next((key for key in ("movement", "endpoint", "kinematic") if key in top.values), None):
        raise top.error(f"has 'movements' and {other!r}: leave one of them out")
    others = top.section("recordings", optional=True).values.keys() - {"takes"}
    if others:
        raise top.section("recordings").error(
            f"has {listed(sorted(others))}, which is about one movement; with 'movements' there may be 'takes' only"
        )
    section, topics = top.section("movements"), {}
    for name, entry in top.sections("movements"):
        if not is_name(name):
            raise section.error(f"has the end point {shown(name)}: use letters, digits and underscores")
        entry.refuse_others("topic", "frames")
        topics[name] = entry.required("topic", a_topic)
    if len(topics) < 2:
        raise section.error("names fewer than two: for one movement write 'movement' and 'endpoint'")
    frames = top.section("frames", optional=True).values
    if both := [name for name in topics if name in frames]:
        raise top.error(f"has {listed(both)} in 'frames' and in 'movements': give the frame another name")
    if movement is None:
        raise top.error(
            f"has the movements {listed(topics)}: say which one is meant, such as {top.source}{OF}{next(iter(topics))}"
        )
    if movement not in topics:
        raise section.error(f"has no {shown(movement)}; expected one of {listed(topics)}")
    known = {**frames, **{name: {"topic": topic} for name, topic in topics.items() if name != movement}}
    entry = section.section(movement)
    chosen = entry.required("frames", some_names) if "frames" in entry.values else tuple(known)
    if unknown := [name for name in chosen if name not in known]:
        raise entry.error(f"is seen from {listed(unknown)}; expected frames and other end points: {listed(known)}")
    for name in chosen:
        source = known[name].get("frame") if isinstance(known[name], dict) else None
        if isinstance(source, str) and source in known and source not in chosen:
            raise entry.error(f"is seen from {shown(name)}, which is derived from {shown(source)}: add that frame too")
    values = {key: value for key, value in top.values.items() if key != "movements"}
    if isinstance(values.get("name"), str):
        values["name"] = f"{values['name']}_{movement}"
    values |= {"movement": topics[movement], "endpoint": movement, "frames": {name: known[name] for name in chosen}}
    return Section(top.file, top.where, values)
