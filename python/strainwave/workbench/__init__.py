"""The workbench: the whole method in a browser, over the public API and the command line.

`app` is the web application. `pages` answer requests with their views; `static` has the scripts of
the pages. `workspace` is the served folder, `runs` are the command lines that run in it, and
`security` guards both. All state is in the folder: a restart, and a second browser,
show the same.
"""

from strainwave.workbench.options import ServerOptions
from strainwave.workbench.server import serve

__all__ = ["ServerOptions", "serve"]
