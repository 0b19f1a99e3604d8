"""One dataset from many machines with Ray. Needs ``ray`` (``pip install facile[ray]``).

>>> import ray, facile.ray
>>> ray.init(address="auto")
>>> facile.ray.generate("/shared/dataset.toml", "/shared/out/demo", shards=200)

Every shard is a task that writes a folder of its own beside ``output``, on storage that all machines see. A task whose
machine is lost is run again and goes on where it stopped. At the end the shards are merged and every file is verified:
the bytes are those of one run on one machine.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import ray

import facile

__all__ = ["generate"]


def _shard(recipe: Any, folder: str, shard: str, jobs: int) -> str:
    facile.generate(recipe, output=folder, jobs=jobs, shard=shard)
    return folder


def generate(
    recipe: facile.Recipe,
    output: str | os.PathLike[str],
    *,
    shards: int,
    jobs: int = 1,
    retries: int = 5,
    keep_shards: bool = False,
) -> dict[str, Any]:
    """Generates a dataset with one Ray task for each of ``shards`` parts; ``jobs`` processors for each.

    ``recipe`` is a mapping or a path that every machine can read. A task is tried again up to ``retries`` times. Returns
    the manifest of the whole.

    Raises :class:`facile.PipelineError` if a shard or a file is missing or damaged at the end.
    """
    if shards < 1:
        raise ValueError(f"shards must be at least 1, found {shards}")
    output = Path(output).absolute()
    source = recipe if not isinstance(recipe, (str, os.PathLike)) else str(Path(recipe).absolute())
    task = ray.remote(_shard).options(num_cpus=jobs, max_retries=retries, retry_exceptions=[OSError])
    folders = [f"{output}-{i}-of-{shards}" for i in range(1, shards + 1)]
    pending = [task.remote(source, folder, f"{i}/{shards}", jobs) for i, folder in enumerate(folders, 1)]
    ray.get(pending)
    manifest = facile.merge(folders, output)
    if not manifest["complete"]:
        raise facile.PipelineError(f"{output}: samples are missing after the merge")
    verdict = facile.verify(output)
    if verdict["bad"]:
        bad = verdict["bad"][0]
        raise facile.PipelineError(f"{bad['path']}: {bad['reason']}; {len(verdict['bad'])} files are bad")
    if not keep_shards:
        for folder in folders:
            shutil.rmtree(folder)
    return manifest
