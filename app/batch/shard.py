"""Some rows that one worker registers and writes as one file."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from app.batch.manifest import ManifestRow


@dataclass(frozen=True, slots=True)
class Shard:
    """Rows that become one file of the results.

    Attributes:
        rows: in the manifest's order.
        digests: of the rows.
    """

    rows: tuple[ManifestRow, ...]
    digests: tuple[str, ...]

    @property
    def name(self) -> str:
        """The file's name, the same for the same rows: who writes twice replaces its like."""
        said = "\n".join(
            f"{row.pair_id}\t{digest}" for row, digest in zip(self.rows, self.digests, strict=True)
        )
        digest = hashlib.sha256(said.encode()).hexdigest()[:16]
        return f"part-{self.rows[0].number:09}-{digest}.parquet"


def shards_of(rows: Sequence[ManifestRow], artifact: str, size: int) -> list[Shard]:
    """Cut rows into shards of a size.

    The cuts lie at multiples of the size in the manifest. What a killed run has left undone is
    therefore whole shards, with the same names again.
    """
    cut: dict[int, list[ManifestRow]] = {}
    for row in rows:
        cut.setdefault(row.number // size, []).append(row)
    return [
        Shard(tuple(part), tuple(row.digest(artifact) for row in part)) for part in cut.values()
    ]
