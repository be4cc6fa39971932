"""Placeholder of the page."""

from starlette.routing import Route

ROUTES: tuple[Route, ...] = ()
