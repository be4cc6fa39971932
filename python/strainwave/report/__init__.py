"""Records -> one self-contained HTML file. Nothing outside `pipeline` and `cli` imports this."""

from strainwave.report.comparisons import render_comparisons
from strainwave.report.page import figures_of, render
from strainwave.report.remedies import by_weight
from strainwave.report.sensor_gains import gain_sentences

__all__ = ["by_weight", "figures_of", "gain_sentences", "render", "render_comparisons"]
