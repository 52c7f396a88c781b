# SPDX-License-Identifier: Apache-2.0
"""`BagError`: why a bag cannot be used."""

from pathlib import Path

from tpgmm_core.common.text import one_line


class BagError(ValueError):
    """A bag that cannot be used; the text names the bag, what was found, what was expected, what to do."""

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(one_line(f"{path}: {text}"))
        self.path, self.text = path, text

    def of_bag(self, bag: Path) -> "BagError":
        """The same of the bag that a file is a part of."""
        return self if self.path == bag else BagError(bag, f"{self.path.name} {self.text}")
