"""A dataset from two worker processes, one of which is killed half-way."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

import facile

RECIPE = {
    "dataset": {"name": "shared", "seed": 6, "formats": ["webdataset"], "images_per_shard": 10},
    "image": {"size": [96, 96], "samples": 4, "truth": ["landmarks", "segments"]},
    "subjects": {"sampled": 12},
    "expression": [{"name": "neutral"}],
    "view": [{"yaw_deg": [-30, -20, -10, 0, 10, 20, 30, 40, 50, 60]}],
    "light": [{"name": f"l{k}", "sources": [{"kind": "point", "position": [100 * k, 200, 800]}]} for k in range(2)],
}


@pytest.fixture
def cluster(needed):
    ray = needed("ray")
    try:
        ray.init(num_cpus=2, include_dashboard=False, configure_logging=False, log_to_driver=False)
    except Exception as error:  # Sandboxes without sockets or shared memory run no cluster.
        pytest.skip(f"no local cluster: {error}")
    yield
    ray.shutdown()


def processes_at_work():
    """Processes of this machine that work on a shard."""
    for status in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if b"ray::_shard" in status.read_bytes():
                yield int(status.parent.name)
        except OSError:
            continue


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="looks for processes in /proc")
def test_a_killed_worker_leaves_no_trace(cluster, tmp_path):
    import facile.ray

    facile.generate(RECIPE, output=tmp_path / "alone")
    result = {}

    def run():
        result["manifest"] = facile.ray.generate(RECIPE, tmp_path / "out", shards=6)

    thread = threading.Thread(target=run)
    thread.start()
    killed = []
    while thread.is_alive() and not killed:
        # Half-way: some files are there, some are not.
        if any(tmp_path.glob("out-*-of-6/webdataset/*.tar")):
            for pid in processes_at_work():
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)
                break
        time.sleep(0.01)
    thread.join()
    assert killed, "no worker was seen at work"
    assert result["manifest"]["complete"] and result["manifest"]["written"] == 240
    sums = [(tmp_path / name / "checksums.b3").read_text() for name in ("alone", "out")]
    assert sums[0] == sums[1]
    assert not list(tmp_path.glob("out-*")), "the shards are removed at the end"
