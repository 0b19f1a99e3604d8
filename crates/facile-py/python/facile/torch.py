"""Samples of a recipe as PyTorch datasets. Needs ``torch``.

>>> from torch.utils.data import DataLoader
>>> from facile.torch import StreamDataset
>>> loader = DataLoader(StreamDataset("dataset.toml"), batch_size=None, num_workers=4)

Every worker makes its own samples; nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import torch.distributed
import torch.utils.data

import facile

__all__ = ["MapDataset", "StreamDataset"]


class MapDataset(torch.utils.data.Dataset[Any]):
    """Sample ``i`` of a recipe, for samplers that choose. Neighbours share their work: prefer blocks to single draws.

    ``transform`` is called with each :class:`facile.Sample`.
    """

    def __init__(self, recipe: facile.Recipe, transform: Callable[[facile.Sample], Any] | None = None) -> None:
        self.samples = facile.Dataset(recipe)
        self.transform = transform

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Any:
        sample = self.samples[index]
        return sample if self.transform is None else self.transform(sample)


class StreamDataset(torch.utils.data.IterableDataset[Any]):
    """All samples of a recipe in order, each made once among all ranks and workers.

    Rank ``r`` of ``R`` with ``W`` workers each: the samples are cut into ``R * W`` blocks of consecutive ones, whose
    lengths differ by at most one, and worker ``w`` makes block ``r * W + w``. ``rank`` and ``ranks`` are taken from
    ``torch.distributed`` where they are not given.
    """

    def __init__(
        self,
        recipe: facile.Recipe,
        transform: Callable[[facile.Sample], Any] | None = None,
        *,
        rank: int | None = None,
        ranks: int | None = None,
    ) -> None:
        self.samples = facile.Dataset(recipe)
        self.transform = transform
        is_distributed = torch.distributed.is_available() and torch.distributed.is_initialized()
        self.rank = rank if rank is not None else torch.distributed.get_rank() if is_distributed else 0
        self.ranks = ranks if ranks is not None else torch.distributed.get_world_size() if is_distributed else 1
        if not 0 <= self.rank < self.ranks:
            raise ValueError(f"rank must be from 0 to {self.ranks - 1}, found {self.rank}")

    def __len__(self) -> int:
        block = self._block(self.rank, self.ranks)
        return len(block)

    def _block(self, block: int, blocks: int) -> range:
        n = len(self.samples)
        return range(n * block // blocks, n * (block + 1) // blocks)

    def __iter__(self) -> Iterator[Any]:
        worker = torch.utils.data.get_worker_info()
        w, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        for index in self._block(self.rank * workers + w, self.ranks * workers):
            sample = self.samples[index]
            yield sample if self.transform is None else self.transform(sample)
