"""The report: an identification as one self-contained HTML file."""

from strainwave.report.document.blocks import FIGURE_KINDS, FigureKind, FigureName
from strainwave.report.document.page import figures_of, find_figure, render

__all__ = ["FIGURE_KINDS", "FigureKind", "FigureName", "figures_of", "find_figure", "render"]
