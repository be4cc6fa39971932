"""Records -> one self-contained HTML file. Nothing outside `pipeline` and `cli` imports this."""

from strainwave.report.comparisons import render_comparisons
from strainwave.report.page import render

__all__ = ["render", "render_comparisons"]
