# SPDX-License-Identifier: Apache-2.0
"""How Sphinx makes the site from docs/ and from the docstrings: `make docs`.

The pages are plain Markdown, so that they read well without the site too. What the site needs beyond that is made here:
the table of contents from the links of two pages, and words in place of links that lead out of docs/.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"

project = "tpgmm"
author = "tpgmm maintainers"
copyright = "tpgmm maintainers, Apache-2.0"
extensions = [
    "myst_parser",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "numpydoc",
]
html_theme = "furo"
html_title = "tpgmm"
html_copy_source = False
exclude_patterns = ["api/modules.rst"]
myst_heading_anchors = 4

# One page for each module, without the compiled loops, which have no users of their own
apidoc_modules = [
    {
        "path": str(ROOT / "src" / "tpgmm_core" / "tpgmm_core"),
        "destination": "api",
        "separate_modules": True,
        "module_first": True,
        "exclude_patterns": ["**/kernels*.py"],
        "automodule_options": {"members", "show-inheritance"},
    }
]
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
# Of docstrings; pages of docs/ are held to account by `myst` warnings, which stay
suppress_warnings = ["docutils", "autodoc", "ref.python"]

LINK = re.compile(r"(?<!!)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s#]+)(#[^()\s]*)?\)")


def prepare(app: Any, name: str, source: list[str]) -> None:
    """Before a page is read: links out of docs/ become words, and two pages get the table of contents."""
    page = DOCS / f"{name}.md"
    if page.exists():
        text = LINK.sub(lambda found: local(page, found), source[0])
        source[0] = text + "".join(contents(page, text))


def local(page: Path, link: re.Match[str]) -> str:
    """A link of a page as the site has it."""
    words, target, _ = link.groups()
    path = Path(os.path.normpath(page.parent / target))
    if "://" in target or path.is_relative_to(DOCS):
        return link[0]
    return f"{words} (`{path.relative_to(ROOT)}`)" if words != str(path.relative_to(ROOT)) else f"`{words}`"


def contents(page: Path, text: str) -> list[str]:
    """Hidden tables of contents: of index.md one for each of its sections, of interfaces.md its other links."""
    if page not in (DOCS / "index.md", DOCS / "interfaces.md"):
        return []
    is_index = page.name == "index.md"
    listed = set() if is_index else set(links(DOCS / "index.md", (DOCS / "index.md").read_text()))
    found = []
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:] if is_index else [f"\n{text}"]:
        caption, _, body = section.partition("\n")
        names = [name for name in dict.fromkeys(links(page, body)) if name not in listed]
        if is_index and caption == "Reference":
            names.append("api/tpgmm_core")
        listed.update(names)
        found.append("\n\n```{toctree}\n:hidden:\n" + (f":caption: {caption}\n\n" if is_index else "\n"))
        found.append("".join(f"{name}\n" for name in names) + "```\n")
    return found


def links(page: Path, text: str) -> list[str]:
    """The pages of docs/ that a text links to, in the order of the text."""
    paths = [
        Path(os.path.normpath(page.parent / found[2])) for found in LINK.finditer(text) if found[2].endswith(".md")
    ]
    return [str(path.relative_to(DOCS).with_suffix("")) for path in paths if path.is_relative_to(DOCS) and path != page]


def setup(app: Any) -> None:
    """Have Sphinx pass each page through `prepare`."""
    app.connect("source-read", prepare)
