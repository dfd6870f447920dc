"""From a sweep to a figure: how often runs succeed and how well they keep to the middle, with 95 % intervals.

    furrow serve --db results.db --threads 4
    python sweep_to_figure.py --url http://127.0.0.1:8080 --seeds 5 --output bounds.png

Needs matplotlib.
"""

from __future__ import annotations

import argparse

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

import furrow

PLAN = "guyonneau2022/bounds"
PANELS = {"success_ratio": "success ratio", "mean_squared_error_mm2_mean": "mean squared error [mm²]"}


def main() -> None:
    """Runs the plan, or takes what is known of it, and draws its table."""
    options = arguments()
    with furrow.Client(options.url) as client:
        sweep = client.submit(PLAN, only={"field": options.field, "algorithm": options.algorithm}, seeds=options.seeds)
        table = sweep.wait().table(metrics=["success", "mean_squared_error_mm2"], statistics=["mean", "ci95"])
    figure, axes = plt.subplots(1, len(PANELS), figsize=(9, 3.6), layout="constrained")
    for panel, (value, label) in zip(axes, PANELS.items()):
        draw(panel, table, value, label)
    axes[1].set_yscale("log")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    figure.savefig(options.output, dpi=150)
    print(options.output)


def draw(axes: Axes, table: pd.DataFrame, value: str, label: str) -> None:
    """One metric: a group per field, a point with its interval per algorithm."""
    stem = value.removesuffix("_mean")
    algorithms, fields = table["algorithm"].unique(), table["field"].unique()
    for place, algorithm in enumerate(algorithms):
        rows = table[table["algorithm"] == algorithm].set_index("field").loc[fields]
        mean = rows[value].to_numpy()
        ends = rows[[f"{stem}_ci95_low", f"{stem}_ci95_high"]].to_numpy()
        # A mean of ratios may stand on the end of its interval, by rounding beyond it.
        reach = np.abs(ends.T - mean)
        offset = 0.15 * (place - (len(algorithms) - 1) / 2)
        axes.errorbar(np.arange(len(fields)) + offset, mean, yerr=reach, fmt="o", capsize=3, label=algorithm)
    axes.set_xticks(np.arange(len(fields)), fields)
    axes.set_xlim(-0.5, len(fields) - 0.5)
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.3)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", help="the server; FURROW_URL or http://127.0.0.1:8080 if not given")
    parser.add_argument("--seeds", type=int, default=5, help="runs per cell (5)")
    parser.add_argument("--field", nargs="+", default=["crop-1", "crop-2", "crop-3", "crop-4"], help="levels to keep")
    parser.add_argument("--algorithm", nargs="+", default=["oracle", "rgop", "heading-hold"], help="levels to keep")
    parser.add_argument("--output", default="bounds.png", help="the picture (bounds.png)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
