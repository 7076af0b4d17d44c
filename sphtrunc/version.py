"""The version of the package, for whoever prints it."""

__version__ = "0.1.0"
