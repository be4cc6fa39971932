"""Version of the package, which results, reports and campaigns state."""

__version__ = "0.2.0"
