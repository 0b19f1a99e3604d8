"""Samples from Python without files: rates in order and at random within a group, and memory.

    python bench/gen/stream.py bench/gen/paper_grid.toml --count 360

The first pass fills the cache of equilibria; passes then alternate, and medians of three are printed.
"""

import argparse
import random
import resource
import statistics
import time

import facile


def cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def rate(dataset: facile.Dataset, order: list[int]) -> float:
    """Samples for each second of one processor."""
    begun = cpu()
    for i in order:
        assert dataset[i]["record"]["index"] == i
    return len(order) / (cpu() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recipe")
    parser.add_argument("--count", type=int, default=360)
    parser.add_argument("--group", type=int, default=180, help="samples of one face")
    parser.add_argument("--lights", type=int, default=5, help="samples of one view")
    arguments = parser.parse_args()
    begun = time.perf_counter()
    dataset = facile.Dataset(arguments.recipe)
    dataset[0]
    print(f"first sample after {time.perf_counter() - begun:.2f} s")
    ordered = list(range(arguments.count))
    # At random within each group: views in any order, or samples in any order
    by_view, by_sample = [], []
    for first in range(0, arguments.count, arguments.group):
        group = ordered[first : first + arguments.group]
        by_sample += random.Random(first).sample(group, len(group))
        views = [group[i : i + arguments.lights] for i in range(0, len(group), arguments.lights)]
        by_view += [i for view in random.Random(first).sample(views, len(views)) for i in view]
    rate(dataset, ordered)
    orders = {"in order": ordered, "views at random": by_view, "samples at random": by_sample}
    rates = {name: [] for name in orders}
    for _ in range(3):
        for name, order in orders.items():
            rates[name].append(rate(dataset, order))
    for name, values in rates.items():
        print(f"{name}: {statistics.median(values):.1f} samples a second of one processor")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory: {peak:.0f} MB")


if __name__ == "__main__":
    main()
