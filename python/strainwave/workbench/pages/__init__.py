"""The pages: each module has the routes of one page."""

from starlette.routing import BaseRoute

from strainwave.workbench.pages import (
    by_hand,
    check,
    compare,
    design,
    estimate,
    files,
    home,
    imports,
    runs,
    signals,
    study,
    virtual,
)

ROUTES: tuple[BaseRoute, ...] = (
    *home.ROUTES,
    *imports.ROUTES,
    *study.ROUTES,
    *check.ROUTES,
    *signals.ROUTES,
    *estimate.ROUTES,
    *compare.ROUTES,
    *by_hand.ROUTES,
    *design.ROUTES,
    *virtual.ROUTES,
    *files.ROUTES,
    *runs.ROUTES,
)
