"""Draw the losses of a training run."""

import csv
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def draw_curve(path: Path) -> None:
    """Turn `curve.csv` (step, minutes, rate, then losses) into a picture of the same name beside it."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    figure = Figure(figsize=(6, 3.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(yscale="log", xlabel="step", ylabel="loss")
    for column, name in enumerate(header[3:], 3):
        axes.plot([int(r[0]) for r in rows], [float(r[column]) for r in rows], label=name, linewidth=1)
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path.with_suffix(".png"), dpi=120)
