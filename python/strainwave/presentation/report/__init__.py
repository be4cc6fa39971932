"""Records -> one self-contained HTML file. Nothing outside `pipeline` and `cli` imports this."""

from strainwave.presentation.report.blocks import slug
from strainwave.presentation.report.comparisons import render_comparisons
from strainwave.presentation.report.page import figures_of, render
from strainwave.presentation.report.remedies import by_weight
from strainwave.presentation.report.sensor_gains import gain_sentences

__all__ = [
    "by_weight",
    "figures_of",
    "gain_sentences",
    "render",
    "render_comparisons",
    "slug",
]
