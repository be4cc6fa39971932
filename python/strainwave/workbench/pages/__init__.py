"""The pages: each module has the routes of one page."""

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

_PAGES = (
    home,
    imports,
    study,
    check,
    signals,
    estimate,
    compare,
    by_hand,
    design,
    virtual,
    files,
    runs,
)
ROUTES = [route for page in _PAGES for route in page.routes]
