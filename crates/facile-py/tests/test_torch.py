"""PyTorch datasets: with torch where it is installed, and against its protocol where it is not.

The wheel of torch that PyPI has for Linux brings gigabytes of CUDA, so the gate goes without it. The stand-in does what
:mod:`facile.torch` relies on as torch documents it: `Dataset` and `IterableDataset` are base classes, `get_worker_info` is
``None`` in the main process and has `id` and `num_workers` in a worker, every worker iterates over a copy of the dataset
that was pickled or forked.
"""

import importlib
import multiprocessing
import pickle
import sys
import types
import typing

import pytest

RECIPE = {
    "dataset": {"name": "torch", "seed": 5},
    "image": {"size": [24, 24], "samples": 1, "truth": ["landmarks"]},
    "subjects": {"sampled": 2},
    "view": [{"yaw_deg": [-20, 20]}],
    "light": [
        {"name": "a", "sources": [{"kind": "point", "position": [400, 200, 800]}]},
        {"name": "b", "sources": [{"kind": "ambient", "intensity": 0.8}]},
    ],
}


def index(sample):
    return sample["record"]["index"]


def stand_in():
    """A module `torch` with what the datasets use."""
    item = typing.TypeVar("item")

    class Dataset(typing.Generic[item]):
        pass

    class IterableDataset(Dataset[item]):
        pass

    torch, utils, data, distributed = (
        types.ModuleType(name) for name in ("torch", "torch.utils", "torch.utils.data", "torch.distributed")
    )
    data.Dataset, data.IterableDataset = Dataset, IterableDataset
    data.worker = None
    data.get_worker_info = lambda: data.worker
    distributed.is_available = lambda: True
    distributed.is_initialized = lambda: False
    torch.utils, torch.distributed, utils.data = utils, distributed, data
    return {module.__name__: module for module in (torch, utils, data, distributed)}


@pytest.fixture
def protocol(monkeypatch):
    for name, module in stand_in().items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "facile.torch", raising=False)
    module = importlib.import_module("facile.torch")
    yield module
    sys.modules.pop("facile.torch", None)


def work(stream, worker, workers, results):
    """What a loader's worker process does."""
    sys.modules["torch.utils.data"].worker = types.SimpleNamespace(id=worker, num_workers=workers)
    results.put(list(stream))


def test_the_map_dataset_follows_the_protocol(protocol):
    dataset = protocol.MapDataset(RECIPE, index)
    assert isinstance(dataset, sys.modules["torch.utils.data"].Dataset)
    assert len(dataset) == 8 and [dataset[i] for i in (6, 0, 7)] == [6, 0, 7]
    with pytest.raises(IndexError):
        dataset[8]
    again = pickle.loads(pickle.dumps(dataset))
    assert again[3] == 3


def test_workers_and_ranks_make_each_sample_once(protocol):
    fork = multiprocessing.get_context("fork")
    seen = []
    for rank in range(3):
        stream = protocol.StreamDataset(RECIPE, index, rank=rank, ranks=3)
        results = fork.Queue()
        workers = [fork.Process(target=work, args=(stream, w, 2, results)) for w in range(2)]
        for process in workers:
            process.start()
        parts = [results.get(timeout=120) for _ in workers]
        for process in workers:
            process.join()
        assert all(part == list(range(part[0], part[0] + len(part))) for part in parts if part)
        seen += [i for part in parts for i in part]
    assert sorted(seen) == list(range(8))


def test_workers_register_after_their_parent_did(protocol, monkeypatch, tmp_path):
    """Threads do not survive a fork: a worker that waited for its parent's would wait for ever."""
    monkeypatch.setenv("FACILE_CACHE", str(tmp_path))
    recipe = RECIPE | {"subjects": {"builtin": ["amara", "bjorn"]}}
    dataset = protocol.MapDataset(recipe, index)
    assert dataset[0] == 0
    fork = multiprocessing.get_context("fork")
    results = fork.Queue()
    worker = fork.Process(target=lambda: results.put(dataset[7]))
    worker.start()
    try:
        assert results.get(timeout=120) == 7
    finally:
        worker.kill()
        worker.join()


def test_ranks_come_from_the_process_group(protocol):
    group = sys.modules["torch.distributed"]
    group.is_initialized, group.get_rank, group.get_world_size = (lambda: True), (lambda: 1), (lambda: 4)
    stream = protocol.StreamDataset(RECIPE, index)
    assert (stream.rank, stream.ranks, len(stream)) == (1, 4, 2)
    assert list(stream) == [2, 3]
    with pytest.raises(ValueError, match="from 0 to 1"):
        protocol.StreamDataset(RECIPE, rank=2, ranks=2)


def test_torch_itself_loads_in_workers():
    torch = pytest.importorskip("torch", reason="skipped: torch is not installed; its protocol is tested")
    from facile.torch import MapDataset, StreamDataset

    seen = []
    for rank in range(3):
        stream = StreamDataset(RECIPE, index, rank=rank, ranks=3)
        loader = torch.utils.data.DataLoader(stream, batch_size=None, num_workers=2, multiprocessing_context="fork")
        seen += list(loader)
    assert sorted(seen) == list(range(8))

    def image(sample):
        return torch.from_numpy(sample["image"])

    loader = torch.utils.data.DataLoader(MapDataset(RECIPE, image), batch_size=4)
    batches = list(loader)
    assert [tuple(batch.shape) for batch in batches] == [(4, 24, 24, 3)] * 2
