"""Records -> one self-contained HTML file. Nothing outside `pipeline` and `cli` imports this."""

from strainwave.report.comparisons import render_comparisons
from strainwave.report.page import figures_of, render
from strainwave.report.remedies import by_weight

__all__ = ["by_weight", "figures_of", "render", "render_comparisons"]
