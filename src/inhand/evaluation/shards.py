"""Parts of a benchmark that run apart from each other, on several machines for example."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from inhand.errors import InputError


class Shard(NamedTuple):
    """One of several parts."""

    number: int
    """Which one, from 1."""
    total: int
    """How many parts there are."""

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """The shard called `text`, such as 2/4.

        Raises:
            InputError: the text is something else.
        """
        match = re.fullmatch(r"(\d+)/(\d+)", text)
        if match:
            shard = cls(*map(int, match.groups()))
            if 1 <= shard.number <= shard.total:
                return shard
        raise InputError(f'a shard is given as NUMBER/COUNT, such as 2/4, got "{text}"')

    def pick(self, files: Sequence[Path]) -> list[Path]:
        """This shard's frames: every `total`-th one, so that all shards take about as long."""
        return list(files[self.number - 1 :: self.total])

    def named(self, name: str) -> str:
        """A file's name with the shard's in it: `results-2of4.jsonl`; a single one keeps its own.

        Shards of one run may so write to one folder.
        """
        if self.total == 1:
            return name
        path = Path(name)
        return f"{path.stem}-{self.number}of{self.total}{path.suffix}"
