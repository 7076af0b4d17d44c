"""The version of the package, for whoever prints it."""

__version__ = "0.2.0"
