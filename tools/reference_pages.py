# SPDX-License-Identifier: Apache-2.0
"""Write the reference pages of nodes, topics, messages and programs from what they declare, so that they stay true.

    .venv/bin/python tools/reference_pages.py            writes them into docs/reference/
    .venv/bin/python tools/reference_pages.py --check    writes nothing; status 1, and the names, where one is stale

Parameters come from the nodes' own declarations. Topics, services and actions come from the nodes themselves: each is
made once as it comes and once in lockstep, on a ROS domain of its own. Messages come from their definition files,
programs from their ``--help``. What nobody declares (what a topic is for, how often it comes) stands in
reference_texts.yaml; a topic without a text there is an error, and so is a text without a topic.
"""

from __future__ import annotations

import argparse
import contextlib
import inspect
import io
import os
import re
import sys
import textwrap
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT / "docs" / "reference"
INTERFACES = ROOT / "src" / "tpgmm_msgs"
TEXTS = Path(__file__).with_name("reference_texts.yaml")
MADE = "<!-- Made by tools/reference_pages.py from the sources: change those, then run `make reference`. -->"
#: The nodes are made in this namespace, so that relative names can be told from absolute ones.
NAMESPACE = "/namespace"
#: Topics and services that every node of ROS has, or every lifecycle node; the pages say so once.
STANDARD = re.compile(
    r"(^/rosout$|^/parameter_events$|/(describe|get|list|set)_parameter\w*$|/get_type_description$"
    r"|/(change|get)_state$|/get_available_\w+$|/get_transition_graph$|/transition_event$|/_action/)"
)


@dataclass(frozen=True)
class Endpoint:
    """One topic, service or action as a node has it."""

    name: str
    kind: str
    qos: str = ""


@dataclass
class NodeFacts:
    """What a node says of itself."""

    about: str
    lifecycle: bool
    parameters: list[Any]
    publishes: list[Endpoint] = field(default_factory=list)
    subscribes: list[Endpoint] = field(default_factory=list)
    services: list[Endpoint] = field(default_factory=list)
    actions: list[Endpoint] = field(default_factory=list)
    lockstep_only: set[str] = field(default_factory=set)


# -- nodes


def node_class(name: str) -> tuple[Any, type]:
    """The module that an executable runs, and its class of node."""
    from rclpy.node import Node

    entry, _, function = programs()[name].partition(":")
    module = import_module(inspect.getclosurevars(getattr(import_module(entry), function)).nonlocals["module"])
    classes = [
        item
        for item in vars(module).values()
        if inspect.isclass(item) and issubclass(item, Node) and item.__module__ == module.__name__
    ]
    if len(classes) != 1:
        raise ValueError(f"{module.__name__}: expected one class of node, found {[item.__name__ for item in classes]}")
    return module, classes[0]


def ask_node(name: str, parameters: dict[str, Any]) -> NodeFacts:
    """Make a node with parameters, configure it where it has a lifecycle, and read what it has."""
    import rclpy
    from rclpy.action import get_action_server_names_and_types_by_node
    from rclpy.lifecycle import LifecycleNode

    module, kind = node_class(name)
    arguments = ["--ros-args", "-r", f"__ns:={NAMESPACE}", "--log-level", "error"]
    for key, value in parameters.items():
        arguments += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
    rclpy.init(args=arguments)
    node = kind()
    lifecycle = isinstance(node, LifecycleNode)
    if lifecycle and node.trigger_configure().name != "SUCCESS":
        raise RuntimeError(f"{name} cannot be configured with {parameters}: see its error above")
    facts = NodeFacts(inspect.getdoc(module) or "", lifecycle, module.PARAMETERS)
    facts.publishes = endpoints((item.topic_name, item.msg_type, item.qos_profile) for item in node.publishers)
    facts.subscribes = endpoints((item.topic_name, item.msg_type, item.qos_profile) for item in node.subscriptions)
    facts.services = endpoints((item.srv_name, item.srv_type, None) for item in node.services)
    actions = get_action_server_names_and_types_by_node(node, node.get_name(), NAMESPACE)
    facts.actions = [Endpoint(relative(action), kinds[0].replace("/action/", "/")) for action, kinds in actions]
    node.destroy_node()
    rclpy.shutdown()
    return facts


def endpoints(found: Any) -> list[Endpoint]:
    """Topics of a node that are its own, in the order of their names."""
    return sorted(
        {
            Endpoint(relative(name), type_name(kind), "" if qos is None else quality(qos))
            for name, kind, qos in found
            if not STANDARD.search(name)
        },
        key=lambda item: item.name,
    )


def relative(name: str) -> str:
    """A name as a node asks for it: relative ones move with its namespace."""
    return name.removeprefix(f"{NAMESPACE}/")


def type_name(kind: Any) -> str:
    """As ROS's tools write it, without the middle: package/Name."""
    return f"{kind.__module__.partition('.')[0]}/{kind.__name__}"


def quality(qos: Any) -> str:
    """A quality of service in words."""
    words = [qos.reliability.name.lower().replace("_", " "), qos.durability.name.lower().replace("_", " ")]
    return f"{', '.join(words)}, depth {qos.depth}"


def facts_of(name: str, parameters: dict[str, Any], lockstep: dict[str, Any]) -> NodeFacts:
    """As the node comes, and what it has beside that in lockstep."""
    parameters = {key: ROOT / value if str(value).startswith("config/") else value for key, value in parameters.items()}
    usual = ask_node(name, parameters)
    if lockstep:
        other = ask_node(name, {**parameters, **lockstep})
        for group in ("publishes", "subscribes"):
            known = {item.name for item in getattr(usual, group)}
            further = [item for item in getattr(other, group) if item.name not in known]
            getattr(usual, group).extend(further)
            usual.lockstep_only |= {item.name for item in further}
    return usual


def node_page(name: str, facts: NodeFacts, texts: dict[str, Any]) -> str:
    """The page of a node."""
    start = " ".join(f"-p {key}:={value}" for key, value in texts["nodes"][name]["start"].items())
    about = re.sub(r"``(.*?)``", r"`\1`", facts.about).replace(f"{name}: ", "", 1)
    lines = [f"# {name}", "", MADE, "", about[:1].upper() + about[1:], ""]
    lines += ["A lifecycle node." if facts.lifecycle else "An ordinary node.", ""]
    lines += [f"    .venv/lib/tpgmm_ros/{name} --ros-args {start}", ""]
    lines += ["Names of topics and services below are those with these files.", ""]
    for title, group in (("Topics it subscribes to", facts.subscribes), ("Topics it publishes", facts.publishes)):
        if group:
            lines += [f"## {title}", "", "| topic | type | quality of service | what |", "| --- | --- | --- | --- |"]
            for item in group:
                what = texts["topics"][item.name]["what"] + (
                    " (in lockstep only)" if item.name in facts.lockstep_only else ""
                )
                lines.append(f"| `{item.name}` | {linked(item.kind)} | {item.qos} | {what} |")
            lines.append("")
    if facts.services or facts.actions:
        lines += ["## Services and actions", "", "| name | type | what |", "| --- | --- | --- |"]
        for item in [*facts.services, *facts.actions]:
            lines.append(f"| `{item.name}` | {linked(item.kind)} | {texts['services'][item.name]} |")
        lines.append("")
    lines += ["## Parameters", "", PARAMETERS_TEXT, "", "| name | default | range | meaning |"]
    lines += ["| --- | --- | --- | --- |", *map(parameter_row, facts.parameters), ""]
    if notes := texts["nodes"][name].get("notes"):
        lines += ["## Notes", "", notes.strip(), ""]
    return "\n".join(lines)


PARAMETERS_TEXT = """\
*Fixed* parameters are read at the start only. All others may be changed while the node runs. `use_sim_time`,
`realtime_priority`, `cpu_cores` and `lock_memory` are those of [every node](../../interfaces.md#parameters)."""


def parameter_row(item: Any) -> str:
    """A parameter as a row of a table."""
    default = f'"{item.default}"' if isinstance(item.default, str) else str(item.default)
    default = default.lower() if isinstance(item.default, bool) else default
    bounds = "" if item.lower is None or item.upper is None else f"{item.lower:g} to {item.upper:g}"
    return f"| `{item.name}` | {default} | {bounds} | {item.description}{' (fixed)' if item.fixed else ''} |"


def linked(kind: str, folder: str = "../messages/") -> str:
    """The name of a type, as a link where it is one of ours."""
    package, _, name = kind.partition("/")
    return f"[{kind}]({folder}{name}.md)" if package == "tpgmm_msgs" else kind


def topics_page(nodes: dict[str, NodeFacts], texts: dict[str, Any]) -> str:
    """The page of all topics."""
    lines = ["# Topics", "", MADE, "", texts["topics_page"].strip(), ""]
    lines += ["| topic | type | from | to | quality of service | rate |", "| --- | --- | --- | --- | --- | --- |"]
    for name, text in texts["topics"].items():
        writers = {node: item for node, facts in nodes.items() for item in facts.publishes if item.name == name}
        readers = {node: item for node, facts in nodes.items() for item in facts.subscribes if item.name == name}
        first, *_ = [*writers.values(), *readers.values()]  # what is promised is what the writer offers
        giver = ", ".join(f"[{node}](nodes/{node}.md)" for node in writers) or text["from"]
        taker = ", ".join(f"[{node}](nodes/{node}.md)" for node in readers) or text["to"]
        kind = linked(first.kind, "messages/")
        lines.append(f"| `{name}` | {kind} | {giver} | {taker} | {first.qos} | {text['rate']} |")
    return "\n".join([*lines, ""])


def check_texts(nodes: dict[str, NodeFacts], texts: dict[str, Any]) -> None:
    """Raises ValueError: a topic or a service without a text, or a text without one."""
    topics = {item.name for facts in nodes.values() for item in [*facts.publishes, *facts.subscribes]}
    services = {item.name for facts in nodes.values() for item in [*facts.services, *facts.actions]}
    for what, found in (("topics", topics), ("services", services)):
        known = set(texts[what])
        if known != found:
            raise ValueError(
                f"{TEXTS.name}, {what}: no text for {sorted(found - known)}; no node has {sorted(known - found)}"
            )


# -- messages


def message_page(path: Path) -> str:
    """A page from a definition: its comments, and a table of the fields, section by section."""
    header, *_ = (part for part in path.read_text().split("\n\n") if part.startswith("# "))
    kind = {".msg": "A message", ".srv": "A service", ".action": "An action"}[path.suffix]
    lines = [f"# {path.stem}", "", MADE, "", f"{kind} of tpgmm_msgs.", "", *paragraphs(header)]
    titles = {
        ".msg": ["Fields"],
        ".srv": ["Request", "Response"],
        ".action": ["Goal", "Result", "Feedback"],
    }[path.suffix]
    body = path.read_text().split(header, 1)[1]
    for title, part in zip(titles, re.split(r"^---$", body, flags=re.MULTILINE), strict=True):
        lines += [f"## {title}", "", *fields_table(part), ""]
    return "\n".join(lines)


def paragraphs(header: str) -> list[str]:
    """The comment at the head of an interface file as text."""
    lines = [line.removeprefix("#").strip() for line in header.splitlines() if not line.startswith("# SPDX")]
    return [*lines, ""]


def fields_table(text: str) -> list[str]:
    """Rows of fields and constants. A comment of its own stands above the fields that it is about."""
    out: list[str] = []
    comment: list[str] = []
    in_table = about_group = False
    for line in text.splitlines():
        if found := re.match(r"([\w/]+(?:\[\])?) +(\w+)(?: *= *(\S+))? *(?:# *(.*))?$", line):
            kind, name, value, meaning = found.groups()
            if comment:
                sentence = " ".join(comment)
                out += ["", sentence + ("." if ". " in sentence else ":"), ""]
                comment, in_table, about_group = [], False, True
            if not in_table:
                out += ["| name | type | meaning |", "| --- | --- | --- |"]
                in_table = True
            shown = f"{kind} = {value}" if value else field_type(kind)
            out.append(f"| `{name}` | {shown} | {meaning or ''} |")
        elif found := re.match(r"\s+# *(.*)", line):  # goes on with the field before
            out[-1] = f"{out[-1].removesuffix(' |')} {found[1]} |"
        elif line.startswith("#"):
            comment.append(line.lstrip("# "))
        elif not line.strip():  # what a comment is about ends here
            if about_group:
                out.append("")
            in_table, about_group = in_table and not about_group, False
        else:
            raise ValueError(f"a line that is no field, constant or comment: {line!r}")
    return out


def field_type(kind: str) -> str:
    """A type, linked to its page where it is one of ours."""
    plain = kind.removesuffix("[]")
    if (INTERFACES / "msg" / f"{plain}.msg").exists():
        return f"[{kind.replace('[]', '\\[\\]')}]({plain}.md)"
    return kind


# -- programs


def programs() -> dict[str, str]:
    """The executables of all packages by name, as `module:function`."""
    found: dict[str, str] = {}
    for package in distributions():
        if (package.metadata["Name"] or "").replace("-", "_").startswith("tpgmm_"):
            points = package.entry_points.select(group="console_scripts")
            found = {item.name: item.value for item in points} | found  # what is first on the path counts
    return found


def help_of(name: str, target: str) -> str:
    """What a program prints for --help."""
    module, _, function = target.partition(":")
    said, status, sys.argv = io.StringIO(), None, [name, "--help"]
    with contextlib.redirect_stdout(said):
        try:
            status = getattr(import_module(module), function)()
        except SystemExit as end:
            status = end.code
    if status:
        raise RuntimeError(f"{name} --help ended with status {status}")
    return said.getvalue().replace(str(ROOT) + os.sep, "").rstrip()


def programs_page(nodes: set[str], texts: dict[str, Any]) -> str:
    """The page of all programs."""
    lines = ["# Programs", "", MADE, "", texts["programs_page"].strip(), ""]
    for name, target in sorted(programs().items()):
        if name not in nodes:
            lines += [f"## {name}", "", textwrap.indent(help_of(name, target), "    ").replace("\n    \n", "\n\n"), ""]
    return "\n".join(lines)


# -- all of them


def pages() -> dict[Path, str]:
    """The text of each page that is made, by its path."""
    texts = yaml.safe_load(TEXTS.read_text())
    nodes = {name: facts_of(name, text["start"], text.get("lockstep", {})) for name, text in texts["nodes"].items()}
    check_texts(nodes, texts)
    made = {REFERENCE / "nodes" / f"{name}.md": node_page(name, facts, texts) for name, facts in nodes.items()}
    for path in sorted(INTERFACES.glob("*/*.*")):
        made[REFERENCE / "messages" / f"{path.stem}.md"] = message_page(path)
    made[REFERENCE / "topics.md"] = topics_page(nodes, texts)
    made[REFERENCE / "programs.md"] = programs_page(set(nodes), texts)
    return {path: re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n" for path, text in made.items()}


def main() -> int:
    """Write the pages, or check them; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 where a page is stale")
    check = parser.parse_args().check
    from domain_coordinator import domain_id

    with domain_id() as domain:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", COLUMNS="110")
        made = pages()
    there = {path for folder in ("nodes", "messages") for path in (REFERENCE / folder).glob("*.md")}
    stale = sorted(path for path, text in made.items() if not path.exists() or path.read_text() != text)
    left = sorted(there - made.keys())
    for path in [*stale, *left]:
        print(f"{path.relative_to(ROOT)}{': stale' if check else ''}")
        if not check and path in left:
            path.unlink()
    if not check:
        for path in stale:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(made[path])
        return 0
    if stale or left:
        print("error: these pages are out of date: run `make reference`", file=sys.stderr)
    return 1 if stale or left else 0


if __name__ == "__main__":
    sys.exit(main())
