"""The report: an identification as one self-contained HTML file."""

from strainwave.presentation.report.blocks import FIGURE_KINDS, FigureKind, FigureName, slug
from strainwave.presentation.report.page import figures_of, find_figure, render
from strainwave.presentation.report.remedies import advice, by_severity, is_note, sentence
from strainwave.presentation.report.rig import gain_sentences
from strainwave.presentation.report.verdict import drive_note, scale_note

__all__ = [
    "FIGURE_KINDS",
    "FigureKind",
    "FigureName",
    "advice",
    "by_severity",
    "drive_note",
    "figures_of",
    "find_figure",
    "gain_sentences",
    "is_note",
    "render",
    "scale_note",
    "sentence",
    "slug",
]
