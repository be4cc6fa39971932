"""Records -> one self-contained HTML file. Nothing outside `pipeline` and `cli` imports this."""

from strainwave.report.comparisons import render_comparisons
from strainwave.report.page import figures_of, render

__all__ = ["figures_of", "render", "render_comparisons"]
